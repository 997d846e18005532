"""What every strategy is: a value that says where the thermal camera stands, found in its own way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtgs.base.files import sha256_of
from rtgs.base.progress import Progress
from rtgs.config import RealExperimentConfig
from rtgs.models import RgbModel
from rtgs.records.scene import Scene
from rtgs.scale import ScaleEstimate


@dataclass(frozen=True, eq=False)
class Given:
    """What every strategy gets.

    Attributes:
        scene: with its rig as calibrated.
        estimate: this package's own scale.
        config: the experiment's settings, a strategy's own among them.
    """

    scene: Scene
    rgb_model: RgbModel
    estimate: ScaleEstimate
    config: RealExperimentConfig


def _as_it_is(image: NDArray[np.float32]) -> NDArray[np.float32]:
    return image


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a strategy puts the thermal camera.

    Attributes:
        scene: the scene to fit the thermal model on.
        sfm_per_metre: SfM units per metre; None for a strategy without a scale, whose model is fitted at 1.
        in_thermal: brings a render `[H, W]` of that scene's thermal camera to the pixels `[h, w]` of the true one, NaN where it has none.
    """

    scene: Scene
    sfm_per_metre: float | None
    in_thermal: Callable[[NDArray[np.float32]], NDArray[np.float32]] = _as_it_is


@dataclass(frozen=True)
class Strategy:
    """One row of the table.

    Attributes:
        key: in file names. title: in tables.
        place: finds the placement. It raises `RtgsError` where it cannot; the table then gives its message as the reason.
        inputs: what the placement depends on beside the scene, the RGB model and the thermal fit's settings, as text or JSON values:
            a row that was made from other inputs is made again.
    """

    key: str
    title: str
    place: Callable[[Given, Progress], Placement]
    inputs: Callable[[Given], Any]


def content_of(path: Path | None) -> Any:
    """Names and SHA-256 of a model's files, for `Strategy.inputs`: another model makes another row, a copy or a `touch` does not."""
    if path is None:
        return None
    if not path.is_dir():
        return [(path.name, sha256_of(path))]
    return [(p.relative_to(path).as_posix(), sha256_of(p)) for p in sorted(path.rglob("*")) if p.is_file()]
