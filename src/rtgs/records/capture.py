"""A capture in memory: its frames, rig, masks, and the poses that came with it.

`rtgs.io.capture` reads it from a folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rtgs.maths.geometry import SE3
from rtgs.records.radiometry import PlanckRadiometry
from rtgs.records.rig import Rig


@dataclass(frozen=True, eq=False)
class Frame:
    """One instant: a synchronised, undistorted pair.

    Attributes:
        name: common stem of both files.
        rgb: `[H, W, 3]` float32 in [0, 1].
        thermal: `[h, w]` float32, °C (or counts, where `Capture.thermal_unit` is "relative").
    """

    name: str
    rgb: NDArray[np.float32]
    thermal: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SparsePoints:
    """SfM points in the world frame: `xyz` `[P, 3]` float64, `rgb` `[P, 3]` float32 in [0, 1]."""

    xyz: NDArray[np.float64]
    rgb: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.xyz)


@dataclass(frozen=True, eq=False)
class Poses:
    """RGB poses that came with a capture: `world_from_rgb` by frame name, and the points, where the source has them."""

    world_from_rgb: Mapping[str, SE3]
    points: SparsePoints | None


@dataclass(frozen=True, eq=False)
class Capture:
    """A capture folder, validated and undistorted.

    Attributes:
        root: the folder.
        raw_rig: cameras as calibrated, lens included, at the files' resolution (SfM reads the files).
        rig: pinhole cameras of the images in `frames`.
        frames: in name order; all of them, registered or not.
        rgb_mask, thermal_mask: `[H, W]`, `[h, w]` bool, pixels that undistortion could fill.
        thermal_unit: "celsius", or "relative" when the rig file gives no radiometry.
        planck: how °C came out of the sensor's signal, where `rig.json` has Planck constants.
        poses: what `transforms.json` or `sparse/0` says, or None: then SfM has to run.
        warnings: what a person should know and can live with.
    """

    root: Path
    raw_rig: Rig
    rig: Rig
    frames: tuple[Frame, ...]
    rgb_mask: NDArray[np.bool_]
    thermal_mask: NDArray[np.bool_]
    thermal_unit: Literal["celsius", "relative"]
    poses: Poses | None
    warnings: tuple[str, ...] = ()
    planck: PlanckRadiometry | None = None
