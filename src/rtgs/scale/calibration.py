"""What an error of the calibration does to the scale."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.records.rig import CalibrationStd, Rig
from rtgs.scale.objective import Objective

Change = Callable[[Rig, float], Rig]


def calibration_std_log(objective: Objective, rig: Rig, theta: float, std: CalibrationStd, frames: Sequence[int]) -> float:
    """Standard deviation of ln s that the calibration's brings, to first order.

    At the minimum the loss has no slope; where a calibration error p gives it one, the minimum moves by dθ/dp = −L_θp / L_θθ, both from
    the Gauss–Newton matrix. The baseline's length is not seen at all: s·|t| is what the images know, so its error is the scale's.
    """
    changes = [(change, sigma) for change, sigma in freedoms(rig, std) if sigma > 0]
    variance = std.baseline_length**2
    if changes:
        matrix = sum(objective.curvatures(i, theta, [c for c, _ in changes]) for i in frames)
        shifts = -matrix[0, 1:] / matrix[0, 0] * np.array([sigma for _, sigma in changes])  # type: ignore[index]
        variance += float(shifts @ shifts)
    return math.sqrt(variance)


def freedoms(rig: Rig, std: CalibrationStd) -> list[tuple[Change, float]]:
    """Ways in which a rig may be off, each a function (rig, amount) → rig, and the amount's standard deviation."""
    across = _across(rig.rgb_from_thermal.translation)
    turns = [_turn(axis) for axis in np.eye(3)]
    tilts = [_tilt(side) for side in across]
    return [
        *((turn, std.rotation_rad) for turn in turns),
        *((tilt, std.baseline_direction) for tilt in tilts),
        (_zoom, std.thermal_focal),
    ]


def _turn(axis: NDArray[np.float64]) -> Change:
    def change(rig: Rig, amount: float) -> Rig:
        pose = rig.rgb_from_thermal
        return replace(rig, rgb_from_thermal=SE3(pose.rotation @ rotation_from_axis_angle(amount * axis), pose.translation))

    return change


def _tilt(side: NDArray[np.float64]) -> Change:
    def change(rig: Rig, amount: float) -> Rig:
        t = rig.rgb_from_thermal.translation
        length = float(np.linalg.norm(t))
        tilted = t + amount * length * side
        return replace(rig, rgb_from_thermal=SE3(rig.rgb_from_thermal.rotation, tilted * length / np.linalg.norm(tilted)))

    return change


def _zoom(rig: Rig, amount: float) -> Rig:
    thermal = rig.thermal
    return replace(rig, thermal=replace(thermal, fl_x=thermal.fl_x * (1 + amount), fl_y=thermal.fl_y * (1 + amount)))


def _across(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """`[2, 3]`: unit vectors at right angles to it and to each other."""
    unit = direction / np.linalg.norm(direction)
    first = np.cross(unit, np.eye(3)[int(np.argmin(np.abs(unit)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(unit, first)])
