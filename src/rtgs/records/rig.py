"""Two cameras fixed to each other, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera


@dataclass(frozen=True)
class CalibrationStd:
    """How well a rig is calibrated: standard deviations, zero for what is taken as exact.

    Attributes:
        baseline_length: of |t|, relative. baseline_direction: of the baseline's tip to either side, relative to |t|.
        rotation_rad: of the rig's rotation, about each axis.
        thermal_focal: of the thermal focal length, relative.
    """

    baseline_length: float = 0.0
    baseline_direction: float = 0.0
    rotation_rad: float = 0.0
    thermal_focal: float = 0.0


@dataclass(frozen=True)
class RigStart:
    """How little is known of a rig that has to be found from the capture. The rig itself is where the search starts.

    Attributes:
        reach_deg: the rotation lies within this angle of the rig's.
        focal_reach: the thermal focal length lies within this share of the rig's.
        baseline_m: distance between the two cameras, where it is known; None: nothing about the rig tells metres, and the rig's
            translation has length 1.
        centre_known: whether the thermal camera's principal point is known; else it is taken to be the middle of the image.
    """

    reach_deg: float = 15.0
    focal_reach: float = 0.15
    baseline_m: float | None = None
    centre_known: bool = False


@dataclass(frozen=True)
class Rig:
    """Two cameras fixed to each other.

    Attributes:
        rgb, thermal: intrinsics.
        rgb_from_thermal: translation in metres.
        calibration_std: None where it is not stated.
        time_offset: how long after the RGB camera the thermal one fires, in intervals between frames.
        start: None for a rig that is known; otherwise it is to be found, and this is where the search starts.
    """

    rgb: Camera
    thermal: Camera
    rgb_from_thermal: SE3
    calibration_std: CalibrationStd | None = None
    time_offset: float = 0.0
    start: RigStart | None = None

    @property
    def baseline_m(self) -> float:
        """Distance between the two optical centres, in metres."""
        return float(np.linalg.norm(self.rgb_from_thermal.translation))
