"""Ways in which a rig may be off from its calibration, and the one list of them.

A new one is a function that gives its motions for a rig, and an entry in `MOTIONS`; its name goes into `rtgs.config.REFINABLE`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.records.rig import CalibrationStd, Rig
from rtgs.records.scene import Scene
from rtgs.renderer import Direction
from rtgs.scale.records import Freedom

_DECIDED = 0.9  # of the prior's standard deviation: above it the images have added little


@dataclass(frozen=True)
class RigMotion:
    """A way in which a rig may move away from its calibration.

    Attributes:
        name: for people, e.g. "rotation about x". unit: for people, e.g. "°".
        per_unit: how much of `unit` an amount of 1 is.
        std: standard deviation of the amount, as the calibration has it: the prior.
        apply: (rig, amount) → the rig moved by this amount. It never changes the baseline's length, which cannot be told from the scale.
    """

    name: str
    unit: str
    per_unit: float
    std: float
    apply: Callable[[Rig, float], Rig]

    def posterior(self, u: float, std: float) -> Freedom:
        """What came out: u in standard deviations of the prior, `std` the amount's standard deviation."""
        mean, after, before = (float(value) * self.per_unit for value in (u * self.std, std, self.std))
        return Freedom(self.name, self.unit, mean, after, before, bool(after <= _DECIDED * before))


@dataclass(frozen=True)
class MotionKind:
    """The motions that one name of `--scale.refine` stands for.

    Attributes:
        default_std: standard deviation of their amounts, where `rig.json` states none.
        stated_std: the one that `rig.json` states; 0 where it does not.
        of: (rig, standard deviation) → its motions.
    """

    default_std: float
    stated_std: Callable[[CalibrationStd], float]
    of: Callable[[Rig, float], list[RigMotion]]


def motions(rig: Rig, names: Sequence[str]) -> tuple[RigMotion, ...]:
    """What these names of `--scale.refine` stand for, with the standard deviations that the rig states, or else the defaults."""
    given, found = rig.calibration_std or CalibrationStd(), list[RigMotion]()
    for name, kind in MOTIONS.items():
        if name in names:
            found += kind.of(rig, kind.stated_std(given) or kind.default_std)
    return tuple(found)


def stated_motions(rig: Rig, besides: Sequence[str] = ()) -> tuple[RigMotion, ...]:
    """What the rig itself states to be uncertain, `besides` what these names stand for."""
    given = rig.calibration_std or CalibrationStd()
    return motions(rig, [name for name, kind in MOTIONS.items() if kind.stated_std(given) > 0 and name not in besides])


def scale_direction(scene: Scene, theta: float) -> Direction:
    """How the thermal camera moves with θ = ln s: x_thermal = Rᵀ(x_rgb − s·t), so ∂x_thermal/∂θ = −s·Rᵀt, in world units."""
    rig = scene.rig
    x, y, z = (
        -scene.world_per_metre(math.exp(theta)) * (rig.rgb_from_thermal.rotation.T @ rig.rgb_from_thermal.translation)
    ).tolist()
    return Direction(translation=(x, y, z))


def _rotations(rig: Rig, std: float) -> list[RigMotion]:
    """About the thermal camera's axes; amounts in radians."""

    def about(axis: NDArray[np.float64]) -> Callable[[Rig, float], Rig]:
        def turned(rig: Rig, amount: float) -> Rig:
            pose = rig.rgb_from_thermal
            return replace(rig, rgb_from_thermal=SE3(pose.rotation @ rotation_from_axis_angle(amount * axis), pose.translation))

        return turned

    return [
        RigMotion(f"rotation about {n}", "°", math.degrees(1.0), std, about(a)) for n, a in zip("xyz", np.eye(3), strict=True)
    ]


def _baseline_directions(rig: Rig, std: float) -> list[RigMotion]:
    """The baseline's tip to two sides, its length kept; amounts relative to the length."""

    def to(side: NDArray[np.float64]) -> Callable[[Rig, float], Rig]:
        def tilted(rig: Rig, amount: float) -> Rig:
            pose, length = rig.rgb_from_thermal, rig.baseline_m
            tip = pose.translation + amount * length * side
            return replace(rig, rgb_from_thermal=SE3(pose.rotation, tip * length / np.linalg.norm(tip)))

        return tilted

    sides = _across(rig.rgb_from_thermal.translation)
    return [RigMotion(f"baseline direction, {n}", "%", 100.0, std, to(side)) for n, side in zip("ab", sides, strict=True)]


def _focal(rig: Rig, std: float) -> list[RigMotion]:
    """Both focal lengths of the thermal camera, by the same factor; amounts relative."""

    def zoomed(rig: Rig, amount: float) -> Rig:
        thermal = rig.thermal
        return replace(rig, thermal=replace(thermal, fl_x=thermal.fl_x * (1 + amount), fl_y=thermal.fl_y * (1 + amount)))

    return [RigMotion("thermal focal length", "%", 100.0, std, zoomed)]


def _time_offset(rig: Rig, std: float) -> list[RigMotion]:
    """How much later the thermal camera fires; amounts in intervals between frames."""

    def later(rig: Rig, amount: float) -> Rig:
        return replace(rig, time_offset=rig.time_offset + amount)

    return [RigMotion("time offset", "frame intervals", 1.0, std, later)]


def _across(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """`[2, 3]`: unit vectors at right angles to it and to each other."""
    unit = direction / np.linalg.norm(direction)
    first = np.cross(unit, np.eye(3)[int(np.argmin(np.abs(unit)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(unit, first)])


# The defaults: a thermal calibration with a heated board reaches 0.1° and 1 % with care; a focal length from a data sheet or a baseline
# from a drawing is worse. Where free-running cameras' nearest frames are paired, they are apart by up to half an interval to either side,
# evenly distributed, which has a standard deviation of 1/√12.
MOTIONS: Mapping[str, MotionKind] = {
    "rotation": MotionKind(math.radians(0.3), lambda std: std.rotation_rad, _rotations),
    "baseline-direction": MotionKind(0.02, lambda std: std.baseline_direction, _baseline_directions),
    "focal": MotionKind(0.02, lambda std: std.thermal_focal, _focal),
    "time-offset": MotionKind(1 / math.sqrt(12), lambda std: 0.0, _time_offset),
}
