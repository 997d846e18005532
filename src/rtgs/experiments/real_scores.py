"""Scores of Table III's rows, all on the same pixels: those that every row has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.config import RealExperimentConfig
from rtgs.evaluation.held_out import temperature_scores
from rtgs.evaluation.records import mean_scores
from rtgs.experiments.real_rows import Row
from rtgs.metrics.basic import psnr, ssim_index
from rtgs.metrics.lpips import SMALLEST_PX, Lpips, Network, available
from rtgs.metrics.scores import SCORES, Score
from rtgs.records.scene import Scene
from rtgs.thermal import training_range

NETWORKS: dict[Network, str] = {"alexnet": "lpips", "vgg16": "lpips_vgg"}
COLUMNS = {**SCORES, "region_c": Score("region", "°C", 2), "region_counts": Score("region", "counts", 1)}
"""Scores of the table by name. The region's is a mean temperature and no error."""


@dataclass(frozen=True)
class Scored:
    """Scores of the rows that ran.

    Attributes:
        frames: row → held-out frame → score → value. means: row → score → mean over frames, and the region's mean temperature.
        share: of the thermal image that was scored.
        lo, hi, unit: range of PSNR, SSIM and LPIPS.
        region_note: a sentence on the region; "" where none was asked for.
        missing: sentences on scores that could not be computed.
    """

    frames: dict[str, dict[str, dict[str, float]]]
    means: dict[str, dict[str, float]]
    share: float
    lo: float
    hi: float
    unit: str
    region_note: str
    missing: list[str]

    @property
    def names(self) -> list[str]:
        """The scores of any row, in the order of the table's columns."""
        return list(dict.fromkeys(name for values in self.means.values() for name in values))

    def lines(self) -> list[str]:
        """One line a row, for a terminal."""
        return [
            f"{key}: " + ", ".join(f"{COLUMNS[k].title} {COLUMNS[k].text(v)}" for k, v in values.items())
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
    """Score every row that has images, on the pixels that all of them have.

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
                "psnr": psnr(a, b, mask=mask),
                "ssim": ssim_index(a, b, mask=mask),
                **{key: net(a, b, mask=mask) for key, net in nets.items()},
                **temperature_scores(image, references[name], mask, radiometry.suffix),
            }
        means[row.key] = mean_scores(list(own.values()))
        progress(done + 1, 2 * len(ran), row.title)
    note = ""
    if config.region is not None:
        frame = config.region_frame or scene.held_out_frames[0].name
        inside = _region(config.region, mask)
        for row in ran:
            means[row.key][f"region_{radiometry.suffix}"] = float(row.images[frame][inside].mean())
        left, top, right, bottom = config.region
        note = (
            f"Region: mean over x {left} to {right}, y {top} to {bottom} of {frame}; "
            f"the thermal image shows {float(references[frame][inside].mean()):.2f} {radiometry.unit}."
        )
    return Scored(frames, means, float(mask.mean()), span.lo, span.hi, radiometry.unit, note, missing)


def _region(box: tuple[int, int, int, int], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """`[h, w]`: the pixels of the mask within left, top, right, bottom.

    Raises:
        RtgsError: there are none.
    """
    left, top, right, bottom = box
    inside = np.zeros_like(mask)
    inside[top:bottom, left:right] = mask[top:bottom, left:right]
    if not inside.any():
        raise RtgsError(f"--region {left} {top} {right} {bottom}: no row's pixels are compared there; choose one further inside.")
    return inside


def _networks(mask: NDArray[np.bool_]) -> tuple[dict[str, Lpips], list[str]]:
    """The LPIPS networks whose weights are found, by score, and a sentence on each of the others."""
    if min(mask.shape) < SMALLEST_PX:
        return {}, [f"No LPIPS: the thermal images are under {SMALLEST_PX} px a side."]
    found, missing = available(list(NETWORKS))
    return {NETWORKS[network]: lpips for network, lpips in found.items()}, missing
