"""What is written of Table III: CSV files, a Markdown page, and a picture a held-out frame."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtgs.base.csv_files import write_csv
from rtgs.base.progress import Progress
from rtgs.experiments.provenance import Page, Provenance
from rtgs.experiments.real_rows import Row
from rtgs.experiments.real_scores import COLUMNS, Scored, common_mask
from rtgs.images.pictures import Picture, error_map, palette, save_png, side_by_side, to_picture, with_colour_bar
from rtgs.records.scene import Scene

TITLE = "Table III: temperatures at scales found in different ways"
ERROR_SHARE = 0.2  # of the range, in pictures
LEAST_HEIGHT_PX = 256  # of a picture's tiles


def write_results(
    out: Path,
    scene: Scene,
    rows: Sequence[Row],
    scored: Scored,
    notes: Sequence[str],
    provenance: Provenance,
    progress: Progress,
) -> list[Path]:
    """`table3.csv`, `table3.md`, `frames.csv` and `pictures/FRAME.png`; returns their paths."""
    out.mkdir(parents=True, exist_ok=True)
    files = [
        _write_table(out / "table3.csv", rows, scored),
        Page(TITLE, _markdown(rows, scored, notes)).write(out / "table3.md", provenance),
        _write_frames(out / "frames.csv", scored),
    ]
    ran = [row for row in rows if row.images]
    mask = common_mask(scene, rows)
    for done, frame in enumerate(scene.held_out_frames):
        path = out / "pictures" / f"{frame.name}.png"
        save_png(path, _picture(frame.thermal, ran, frame.name, mask, scored))
        files.append(path)
        progress(done + 1 + len(scene.held_out_frames), 2 * len(scene.held_out_frames), frame.name)
    return files


def _scale(row: Row) -> str:
    return "" if row.sfm_per_metre is None else f"{row.sfm_per_metre:.6g}"


def _write_table(path: Path, rows: Sequence[Row], scored: Scored) -> Path:
    def line(row: Row) -> list[str]:
        values = scored.means.get(row.key, {})
        return [row.key, _scale(row), *(f"{values[n]:.6g}" if n in values else "" for n in scored.names), row.why]

    return write_csv(path, ["row", "sfm_per_metre", *scored.names, "why_not"], map(line, rows))


def _write_frames(path: Path, scored: Scored) -> Path:
    names = [name for name in scored.names if not name.startswith("region")]
    lines = [
        [key, frame, *(f"{values[n]:.6g}" if n in values else "" for n in names)]
        for key, frames in scored.frames.items()
        for frame, values in frames.items()
    ]
    return write_csv(path, ["row", "frame", *names], lines)


def _markdown(rows: Sequence[Row], scored: Scored, notes: Sequence[str]) -> str:
    lines = [
        "| strategy | SfM units per metre | " + " | ".join(COLUMNS[n].heading for n in scored.names) + " |",
        "|---|" + "---:|" * (1 + len(scored.names)),
    ]
    for row in rows:
        values = scored.means.get(row.key, {})
        cells = [COLUMNS[n].number(values[n]) if n in values else "–" for n in scored.names]
        lines.append(f"| {row.title} | {_scale(row) or '–'} | " + " | ".join(cells) + " |")
    absent = [f"{row.title} was not run: {row.why}" for row in rows if not row.images]
    return "\n".join([*lines, "", *(f"- {note}" for note in [*notes, *absent]), ""])


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
    labels = [f"{row.title} {COLUMNS['psnr'].text(scored.frames[row.key][name]['psnr'])}" for row in rows]
    lines = [side_by_side(above, ["thermal image", *labels]), side_by_side(below, ["compared (white)", *("error" for _ in rows)])]
    widest = max(line.shape[1] for line in lines)
    return np.concatenate([np.pad(line, ((0, 0), (0, widest - line.shape[1]), (0, 0)), mode="edge") for line in lines])
