"""What of the calibration can be refined with the scale, and how far it may be off."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.records.capture import Frame
from rtgs.records.rig import CalibrationStd, Rig
from rtgs.records.scene import Scene
from rtgs.scale.calibration import Change, freedoms
from rtgs.scale.records import Freedom

# Where rig.json does not say. A thermal calibration with a heated board reaches 0.1° and 1 % with care; a data sheet's focal length or a
# baseline read off a drawing is worse. Free-running cameras whose nearest frames are paired differ by up to half an interval to either
# side, evenly: standard deviation 1/√12.
DEFAULT_STD = CalibrationStd(rotation_rad=math.radians(0.3), baseline_direction=0.02, thermal_focal=0.02)
TIME_OFFSET_STD = 1 / math.sqrt(12)

_FEWEST = 4  # frames
_ROUGH_STEP = 0.6  # of a frame interval: a pose that its neighbours' middle misses by more says nothing about the time in between
_DECIDED = 0.9  # of the prior's standard deviation


@dataclass(frozen=True)
class Unknown:
    """A number that is refined beside ln s.

    Attributes:
        name, unit: for people. per_unit: of the unit, in one of the change's amount.
        change: (rig, amount) → rig. std: the prior's, in amounts.
    """

    name: str
    unit: str
    per_unit: float
    change: Change
    std: float

    def posterior(self, u: float, std: float) -> Freedom:
        """In the unit for people, from u (in standard deviations of the prior) and the amount's standard deviation."""
        mean, after, before = (float(value) * self.per_unit for value in (u * self.std, std, self.std))
        return Freedom(self.name, self.unit, mean, after, before, bool(after <= _DECIDED * before))


def unknowns(rig: Rig, names: Sequence[str]) -> list[Unknown]:
    """What `ScaleConfig.refine` names, with standard deviations from the rig, or the defaults where it states none (or zero)."""
    given = rig.calibration_std or CalibrationStd()
    spread = {k: getattr(given, k) or getattr(DEFAULT_STD, k) for k in ("rotation_rad", "baseline_direction", "thermal_focal")}
    ways, degrees = freedoms(rig, CalibrationStd(**spread)), math.degrees(1.0)
    table = [("rotation", f"rotation about {axis}", "°", degrees, way) for axis, way in zip("xyz", ways[:3], strict=True)]
    table += [("baseline-direction", f"baseline direction, {i}", "%", 100.0, w) for i, w in zip("ab", ways[3:5], strict=True)]
    table += [("focal", "thermal focal length", "%", 100.0, ways[5])]
    table += [("time-offset", "time offset", "frame intervals", 1.0, (_later, TIME_OFFSET_STD))]
    return [Unknown(name, unit, per, change, std) for key, name, unit, per, (change, std) in table if key in names]


def stated(rig: Rig, besides: Sequence[str]) -> list[Unknown]:
    """What the rig says is uncertain and is not refined: held, and its uncertainty passed on to the scale."""
    std = rig.calibration_std or CalibrationStd()
    fields = {"rotation": std.rotation_rad, "baseline-direction": std.baseline_direction, "focal": std.thermal_focal}
    return unknowns(rig, [name for name, value in fields.items() if value > 0 and name not in besides])


def _later(rig: Rig, amount: float) -> Rig:
    return replace(rig, time_offset=rig.time_offset + amount)


def check_refinable(scene: Scene, frames: Sequence[Frame], names: Sequence[str]) -> None:
    """Before long work: is there enough to refine from? A time offset needs frames that follow each other.

    Raises:
        RtgsError: too few of the training frames that are to be used; or, for a time offset, too few frames with both neighbours, or
            camera positions that do not run smoothly in name order.
    """
    if names and len(frames) < _FEWEST:
        raise RtgsError(
            f"scale.refine: {len(frames)} training frames are used; the calibration is refined from {_FEWEST} or more. Leave it out."
        )
    if "time-offset" not in names:
        return
    rough = []
    for name in scene.world_from_rgb:
        before, after = scene.neighbours(name)
        if before is not None and after is not None:
            pose = scene.world_from_rgb[name]
            step = float(np.linalg.norm(after.translation - before.translation)) / 2
            rough.append(
                float(np.linalg.norm((before.translation + after.translation) / 2 - pose.translation) / max(step, 1e-12))
            )
    if len(rough) < 3:
        raise RtgsError(
            "scale.refine time-offset: fewer than three frames have both neighbours registered; it needs a sequence in the order of "
            "the frames' names. Leave time-offset out."
        )
    if np.median(rough) > _ROUGH_STEP:
        raise RtgsError(
            f"scale.refine time-offset: the camera does not move smoothly from frame to frame in the order of their names (a frame "
            f"lies {np.median(rough):.2g} steps away from the middle of its neighbours), so that nothing is known about the time in "
            "between. Name the files in the order of time, or leave time-offset out."
        )
