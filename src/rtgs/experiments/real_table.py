"""Table III's rows on disk, their scores, and what is written of them: CSV, Markdown, a picture a held-out frame."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.files import write_text_whole, write_whole
from rtgs.base.progress import Progress
from rtgs.config import RealExperimentConfig
from rtgs.images.pictures import Picture, error_map, palette, save_png, side_by_side, to_picture, with_colour_bar
from rtgs.metrics.basic import mae, psnr, ssim_index
from rtgs.metrics.lpips import SMALLEST_PX, Lpips, Network
from rtgs.records.scene import Scene
from rtgs.thermal import training_range

NETWORKS: dict[str, Network] = {"lpips_alex": "alexnet", "lpips_vgg": "vgg16"}
HEADINGS = {
    "psnr_db": "PSNR, dB",
    "ssim": "SSIM",
    "lpips_alex": "LPIPS (AlexNet)",
    "lpips_vgg": "LPIPS (VGG)",
    "mae_c": "MAE, °C",
    "mae_counts": "MAE, counts",
    "region_c": "region, °C",
    "region_counts": "region, counts",
}
DIGITS = {"psnr_db": 2, "mae_counts": 1, "region_c": 2, "region_counts": 1}  # three for the others
ERROR_SHARE = 0.2  # of the range, in pictures
LEAST_HEIGHT_PX = 256  # of a picture's tiles


@dataclass(frozen=True, eq=False)
class Row:
    """One way to place the thermal camera, and what came of it.

    Attributes:
        sfm_per_metre: None for a way without one.
        images: held-out frame → `[h, w]` in the thermal camera, NaN where there is no pixel; empty where the row could not run.
        why: why it could not.
    """

    key: str
    title: str
    sfm_per_metre: float | None
    images: Mapping[str, NDArray[np.float32]]
    why: str = ""
    seconds: float = 0.0

    def write(self, path: Path, fingerprint: str) -> None:
        """Whole or not at all."""
        memory = io.BytesIO()
        np.savez_compressed(
            memory,
            fingerprint=np.array(fingerprint),
            numbers=np.array([np.nan if self.sfm_per_metre is None else self.sfm_per_metre, self.seconds]),
            names=np.array(list(self.images)),
            images=np.stack(list(self.images.values())),
        )
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_whole(path) as temporary:
            temporary.write_bytes(memory.getvalue())

    @staticmethod
    def read(path: Path, title: str, fingerprint: str) -> Row | None:
        """What `write` left, or None: there is none, or one of other inputs."""
        if not path.exists():
            return None
        try:
            with np.load(path) as data:
                if str(data["fingerprint"]) != fingerprint:
                    return None
                found, seconds = data["numbers"].tolist()
                images = dict(zip(data["names"].tolist(), data["images"], strict=True))
        except (OSError, ValueError, KeyError) as error:
            raise RtgsError(f"{path}: unreadable ({error}); remove it and call again.") from error
        return Row(path.stem, title, None if np.isnan(found) else found, images, seconds=seconds)


@dataclass(frozen=True)
class Scored:
    """Scores of the rows that ran.

    Attributes:
        frames: row → held-out frame → score → value. means: row → score → mean over frames, and the region's mean temperature.
        share: of the thermal image that was scored.
        lo, hi, unit: of the range. missing: sentences about scores that there are not.
    """

    frames: dict[str, dict[str, dict[str, float]]]
    means: dict[str, dict[str, float]]
    share: float
    lo: float
    hi: float
    unit: str
    region_note: str
    missing: list[str]

    def lines(self) -> list[str]:
        """For a terminal: a line a row."""
        return [
            f"{key}: " + ", ".join(f"{HEADINGS[k]} {shown(k, v)}" for k, v in values.items())
            for key, values in self.means.items()
        ]


def common_mask(scene: Scene, rows: Sequence[Row]) -> NDArray[np.bool_]:
    """`[h, w]`: thermal pixels that are valid and that every row which ran has, in every frame."""
    mask = scene.capture.thermal_mask.copy()
    for row in rows:
        for image in row.images.values():
            mask &= np.isfinite(image)
    return mask


def score(scene: Scene, rows: Sequence[Row], config: RealExperimentConfig, progress: Progress) -> Scored:
    """Every row that ran, on the pixels that all of them have.

    Raises:
        RtgsError: the region has no such pixel.
    """
    mask, span = common_mask(scene, rows), training_range(scene)
    radiometry = scene.capture.radiometry
    nets, missing = _networks(mask)
    frames: dict[str, dict[str, dict[str, float]]] = {}
    means: dict[str, dict[str, float]] = {}
    ran = [row for row in rows if row.images]
    references = {f.name: f.thermal for f in scene.held_out_frames}
    for done, row in enumerate(ran):
        own = frames[row.key] = {}
        for name, image in row.images.items():
            a, b = span.normalise(np.where(mask, image, span.lo)), span.normalise(references[name])
            own[name] = {
                "psnr_db": psnr(a, b, mask=mask),
                "ssim": ssim_index(a, b, mask=mask),
                **{key: net(a, b, mask=mask) for key, net in nets.items()},
                f"mae_{radiometry.suffix}": mae(image, references[name], mask=mask),
            }
        means[row.key] = {key: float(np.mean([s[key] for s in own.values()])) for key in next(iter(own.values()))}
        progress(done + 1, 2 * len(ran), row.title)
    note = ""
    if config.region is not None:
        left, top, right, bottom = config.region
        name = config.region_frame or scene.held_out_frames[0].name
        inside = np.zeros_like(mask)
        inside[top:bottom, left:right] = mask[top:bottom, left:right]
        if not inside.any():
            raise RtgsError(
                f"--region {left} {top} {right} {bottom}: no row's pixels are compared there; choose one further inside."
            )
        for row in ran:
            means[row.key][f"region_{radiometry.suffix}"] = float(row.images[name][inside].mean())
        shows = float(references[name][inside].mean())
        note = (
            f"Region: mean over x {left} to {right}, y {top} to {bottom} of {name}; "
            f"the thermal image shows {shows:.2f} {radiometry.unit}."
        )
    return Scored(frames, means, float(mask.mean()), span.lo, span.hi, radiometry.unit, note, missing)


def _networks(mask: NDArray[np.bool_]) -> tuple[dict[str, Lpips], list[str]]:
    """The LPIPS networks that can be had, and sentences about the others."""
    if min(mask.shape) < SMALLEST_PX:
        return {}, [f"No LPIPS: the thermal images are under {SMALLEST_PX} px a side."]
    found, missing = {}, []
    for key, network in NETWORKS.items():
        try:
            found[key] = Lpips.load(network)
        except RtgsError as error:
            missing.append(f"No {HEADINGS[key]}: {error}")
    return found, missing


def write_results(
    out: Path, scene: Scene, rows: Sequence[Row], scored: Scored, notes: Sequence[str], progress: Progress
) -> list[Path]:
    """`table3.csv`, `table3.md`, `frames.csv` and `pictures/FRAME.png`."""
    names = list(dict.fromkeys(k for values in scored.means.values() for k in values))
    table = [["row", "sfm_per_metre", *names, "why_not"]]
    lines = [
        "| strategy | SfM units per metre | " + " | ".join(HEADINGS[n] for n in names) + " |",
        "|---|" + "---:|" * (1 + len(names)),
    ]
    for row in rows:
        scale = "" if row.sfm_per_metre is None else f"{row.sfm_per_metre:.6g}"
        values = scored.means.get(row.key, {})
        table.append([row.key, scale, *(f"{values[n]:.6g}" if n in values else "" for n in names), row.why])
        cells = [shown(n, values[n]) if n in values else "–" for n in names]
        lines.append(f"| {row.title} | {scale or '–'} | " + " | ".join(cells) + " |")
    absent = [f"{row.title} was not run: {row.why}" for row in rows if not row.images]
    text = "\n".join([*lines, "", *(f"- {note}" for note in [*notes, *absent]), ""])
    per_frame = [["row", "frame", *(n for n in names if not n.startswith("region"))]]
    for key, frames in scored.frames.items():
        per_frame += [[key, name, *(f"{v:.6g}" for v in values.values())] for name, values in frames.items()]
    out.mkdir(parents=True, exist_ok=True)
    files = [out / "table3.csv", out / "table3.md", out / "frames.csv"]
    for path, data in zip(files, (_csv(table), text, _csv(per_frame)), strict=True):
        write_text_whole(path, data)
    ran = [row for row in rows if row.images]
    mask = common_mask(scene, rows)
    for done, frame in enumerate(scene.held_out_frames):
        path = out / "pictures" / f"{frame.name}.png"
        save_png(path, _picture(frame.thermal, ran, frame.name, mask, scored))
        files.append(path)
        progress(done + 1 + len(scene.held_out_frames), 2 * len(scene.held_out_frames), frame.name)
    return files


def _picture(thermal: NDArray[np.float32], rows: Sequence[Row], name: str, mask: NDArray[np.bool_], scored: Scored) -> Picture:
    """Above the thermal image and the renders, below what is compared and the errors; gray where no row is scored."""
    lo, hi, unit = scored.lo, scored.hi, scored.unit
    limit = ERROR_SHARE * (hi - lo)
    factor = -(-LEAST_HEIGHT_PX // len(thermal))

    def large(image: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.where(mask, image, np.nan).repeat(factor, axis=0).repeat(factor, axis=1)

    above = [palette(large(image), lo, hi) for image in (thermal, *(row.images[name] for row in rows))]
    above[-1] = with_colour_bar(above[-1], lo, hi, unit)
    below = [to_picture(np.where(mask, 1.0, 0.4).repeat(factor, axis=0).repeat(factor, axis=1))]
    below += [error_map(large(row.images[name]), large(thermal), limit, unit) for row in rows]
    width = thermal.shape[1] * factor
    below = [b[:, :width] for b in below[:-1]] + below[-1:]  # one bar a line
    labels = [f"{row.title} {scored.frames[row.key][name]['psnr_db']:.2f} dB" for row in rows]
    lines = [side_by_side(above, ["thermal image", *labels]), side_by_side(below, ["compared (white)", *("error" for _ in rows)])]
    widest = max(line.shape[1] for line in lines)
    return np.concatenate([np.pad(line, ((0, 0), (0, widest - line.shape[1]), (0, 0)), mode="edge") for line in lines])


def shown(name: str, value: float) -> str:
    """A score as tables have it."""
    return f"{value:.{DIGITS.get(name, 3)}f}"


def _csv(table: Sequence[Sequence[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(table)
    return text.getvalue()
