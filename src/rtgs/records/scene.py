"""The scene: images with RGB poses, and from them the poses of the thermal camera (Eq. 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rtgs.maths.geometry import SE3, Array, Sim3, axis_angle_from_rotation, rotation_from_axis_angle
from rtgs.records.capture import Capture, Frame, SparsePoints, Split
from rtgs.records.rig import Rig
from rtgs.records.world import POINT_STEP, POSITION_STEP, given_from_world, on_grid, power_of_two, spread


@dataclass(frozen=True, eq=False)
class Scene:
    """A capture with RGB poses: what every later stage starts from.

    Attributes:
        capture: images, masks, rig.
        world_from_rgb: pose by name, of the frames that were registered.
        points: sparse points, possibly none, in the world.
        failures: name → reason, of the frames that were not.
        split: which frames are for training, validation and evaluation.
        given_from_world: from the world to the frame that SfM or the capture's poses gave, whose unit is the SfM unit.
    """

    capture: Capture
    world_from_rgb: Mapping[str, SE3]
    points: SparsePoints
    failures: Mapping[str, str]
    split: Split = field(default_factory=Split)
    given_from_world: Sim3 = field(default_factory=Sim3.identity)

    def recentred(self) -> Scene:
        """The same scene in the world that suits its cameras (`rtgs.records.world`)."""
        given = self.as_given()
        return given.in_world_of(given_from_world(given.world_from_rgb.values()))

    def in_world_of(self, given_from_world: Sim3) -> Scene:
        """A scene in the given frame, as it is in another world."""
        return replace(
            self,
            world_from_rgb={name: given_from_world.carry_inverse(pose) for name, pose in self.world_from_rgb.items()},
            points=SparsePoints(given_from_world.apply_inverse(self.points.xyz), self.points.rgb),
            given_from_world=given_from_world,
        )

    def as_given(self) -> Scene:
        """The same scene in the given frame, in SfM units: what a user sees."""
        given = self.given_from_world
        return replace(
            self,
            world_from_rgb={name: given.carry(pose) for name, pose in self.world_from_rgb.items()},
            points=SparsePoints(given.apply(self.points.xyz), self.points.rgb),
            given_from_world=Sim3.identity(),
        )

    def steady(self) -> Scene:
        """The same scene with camera positions and points rounded to a grid.

        Training and triangulation are chaotic: the last digit of one position decides how each Gaussian comes to lie, and so the third
        digit of PSNR. An origin far away costs last digits. On the grid they are equal again at (nearly) every origin.
        """
        centres = np.stack([pose.translation for pose in self.world_from_rgb.values()])
        size = power_of_two(spread(centres, np.median(centres, axis=0)))
        poses = {k: SE3(p.rotation, on_grid(p.translation, POSITION_STEP * size)) for k, p in self.world_from_rgb.items()}
        points = SparsePoints(on_grid(self.points.xyz, POINT_STEP * size), self.points.rgb)
        return replace(self, world_from_rgb=poses, points=points)

    def world_per_metre(self, sfm_per_metre: Array) -> Array:
        """World units per metre, from SfM units per metre: a number, or a tensor of one."""
        return sfm_per_metre / self.given_from_world.factor

    @property
    def rig(self) -> Rig:
        """The undistorted cameras."""
        return self.capture.rig

    @cached_property
    def frames(self) -> tuple[Frame, ...]:
        """Registered frames in name order."""
        return tuple(f for f in self.capture.frames if f.name in self.world_from_rgb)

    @cached_property
    def _held_out_names(self) -> frozenset[str]:
        return self.split.held_out_names([f.name for f in self.capture.frames])

    @cached_property
    def train_frames(self) -> tuple[Frame, ...]:
        """Registered frames that a fit may see, those for validation included."""
        return tuple(f for f in self.frames if f.name not in self._held_out_names)

    @cached_property
    def validation_frames(self) -> tuple[Frame, ...]:
        """The training frames that choose settings."""
        names = self.split.validation_names([f.name for f in self.train_frames])
        return tuple(f for f in self.train_frames if f.name in names)

    @cached_property
    def held_out_frames(self) -> tuple[Frame, ...]:
        """Registered frames that only the evaluation sees."""
        return tuple(f for f in self.frames if f.name in self._held_out_names)

    def rgb_from_world(self, name: str) -> SE3:
        """The inverse of a frame's `world_from_rgb`."""
        return self.world_from_rgb[name].inverse()

    @cached_property
    def _order(self) -> dict[str, int]:
        return {f.name: i for i, f in enumerate(self.capture.frames)}

    def neighbours(self, name: str) -> tuple[SE3 | None, SE3 | None]:
        """The RGB poses of the frames just before and after, in name order; None where there is none, or not registered."""
        at, frames = self._order[name], self.capture.frames
        before = self.world_from_rgb.get(frames[at - 1].name) if at > 0 else None
        after = self.world_from_rgb.get(frames[at + 1].name) if at + 1 < len(frames) else None
        return before, after

    def world_from_rgb_at_thermal(self, name: str) -> SE3:
        """Where the RGB camera stands when a frame's thermal picture is taken: `rig.time_offset` frame intervals later.

        The position runs on the parabola through the neighbours, and so does the rotation vector from this frame's; at an end, or
        beside a frame that was not registered, on a straight line. Where both neighbours are missing the camera is taken to stand.
        """
        pose, offset = self.world_from_rgb[name], self.rig.time_offset
        if offset == 0.0:
            return pose
        before, after = self.neighbours(name)
        forth = None if after is None else _motion(pose, after)
        back = None if before is None else -_motion(pose, before)
        if forth is None and back is None:
            return pose
        forth, back = back if forth is None else forth, forth if back is None else back
        assert forth is not None and back is not None
        turn, shift = np.split(offset * (forth + back) / 2 + offset**2 * (forth - back) / 2, 2)
        return SE3(pose.rotation @ rotation_from_axis_angle(turn), pose.translation + shift)

    def world_from_thermal(self, name: str, sfm_per_metre: float) -> SE3:
        """Eq. 1: `world_from_rgb ∘ (R, s·t)`, with the RGB camera where it stands when the thermal one fires."""
        rgb_from_thermal = self.rig.rgb_from_thermal.with_baseline_scaled(self.world_per_metre(sfm_per_metre))
        return self.world_from_rgb_at_thermal(name) @ rgb_from_thermal

    def thermal_from_world(self, name: str, sfm_per_metre: float) -> SE3:
        """The inverse of `world_from_thermal`."""
        return self.world_from_thermal(name, sfm_per_metre).inverse()

    @cached_property
    def extent(self) -> float:
        """Radius of the camera positions about their mean, × 1.1: the unit of 3DGS's position learning rate."""
        centres = np.stack([p.translation for p in self.world_from_rgb.values()])
        return float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()) * 1.1


def _motion(here: SE3, there: SE3) -> NDArray[np.float64]:
    """`[6]`: rotation vector in the camera's own frame, and shift in the world."""
    return np.concatenate([axis_angle_from_rotation(here.rotation.T @ there.rotation), there.translation - here.translation])
