"""What a calibration with a board says: `calibration.json`."""

from __future__ import annotations

from dataclasses import dataclass

from rtgs.config.calibration import BoardConfig


@dataclass(frozen=True)
class Value:
    """A number with its standard deviation, in `unit`."""

    name: str
    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class CameraResult:
    """One camera.

    Attributes:
        model: COLMAP's name. model_criteria: Bayesian information criterion of each model that was tried; the smallest is chosen.
        values: intrinsics with standard deviations.
        residual_px: root mean square distance of corners from the fit.
        noise_px: standard deviation of a corner in each direction, from this camera alone.
        repeated_px: root mean square of the mean residual of each corner, over all pictures. It is large where the board is not
            flat, or its squares are not where they should be.
    """

    model: str
    model_criteria: dict[str, float]
    values: tuple[Value, ...]
    residual_px: float
    noise_px: float
    repeated_px: float


@dataclass(frozen=True)
class PairResult:
    """Root mean square distances in one pair, in pixels: corners from the fit, and thermal corners from where RGB and rig put them."""

    name: str
    rgb_px: float
    thermal_px: float
    disagreement_px: float


@dataclass(frozen=True)
class Rejected:
    """A pair that was left out, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class Agreement:
    """Whether the pairs agree on one rigid transform.

    Attributes:
        agree: whether noise alone explains how they differ.
        ratio: disagreement over that of noise alone; 1 is expected of a rigid rig.
        disagreement_px: median over pairs, in thermal pixels.
        rotation_deg, translation_mm: root mean square differences of the pairs' own transforms from the common one.
        sentence: for people.
    """

    agree: bool
    ratio: float
    disagreement_px: float
    rotation_deg: float
    translation_mm: float
    sentence: str


@dataclass(frozen=True)
class TargetCalibration:
    """Everything that was found.

    Attributes:
        rig: of `rgb_from_thermal`: rotation vector, translation, length of the baseline.
        pointing_deg: standard deviation of where a ray through the middle of the thermal image points in the RGB image, and of the roll:
            the larger. Errors of rotation and principal points largely cancel in it.
    """

    board: BoardConfig
    rgb: CameraResult
    thermal: CameraResult
    rig: tuple[Value, ...]
    pointing_deg: float
    agreement: Agreement
    pairs: tuple[PairResult, ...]
    rejected: tuple[Rejected, ...]
