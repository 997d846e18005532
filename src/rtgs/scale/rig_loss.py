"""The loss as a function of the scale and the calibration together, with its gradient and curvatures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rtgs.maths.geometry import SE3
from rtgs.records.camera import INTRINSICS, Camera
from rtgs.records.gaussians import Gaussians
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.renderer import Direction
from rtgs.scale.objective import Objective
from rtgs.scale.progress import RenderProgress
from rtgs.scale.rig_motion import RigMotion, scale_direction

Vector = NDArray[np.float64]

_DIFFERENCE = 1e-4  # of a prior's standard deviation, for the derivatives of poses
_POINTS = 2000
_STILL = 1e-3  # pixels per standard deviation: less does not count as motion


@dataclass(frozen=True, eq=False)
class Point:
    """What the frames say at one place x = (θ, u).

    Attributes:
        losses: `[F]`. gradients: `[F, K]`, of each frame. gauss_newton: `[K, K]`, mean over frames.
    """

    x: Vector
    losses: Vector
    gradients: Vector
    gauss_newton: Vector

    @property
    def gradient(self) -> Vector:
        """`[K]`: of the mean loss."""
        return self.gradients.mean(axis=0)


@dataclass(frozen=True, eq=False)
class RigLoss:
    """The loss over x = (θ, u), K numbers in all: θ = ln s, and u the amounts of the motions in standard deviations of their priors.

    Attributes:
        scene: with the rig as calibrated, which u = 0 stands for. motions: K − 1 of them.
    """

    scene: Scene
    motions: tuple[RigMotion, ...]
    progress: RenderProgress

    @property
    def size(self) -> int:
        """K: how many numbers x has."""
        return 1 + len(self.motions)

    @property
    def prior(self) -> Vector:
        """`[K, K]`: P, the prior's precision; nothing is known about θ."""
        return np.diag([0.0, *np.ones(len(self.motions))])

    def rig(self, x: Vector) -> Rig:
        """The rig at x; its scale is not in it."""
        rig = self.scene.rig
        for motion, u in zip(self.motions, x[1:], strict=True):
            rig = motion.apply(rig, float(u) * motion.std)
        return rig

    def scene_at(self, x: Vector) -> Scene:
        """The scene with the rig at x."""
        return replace(self.scene, capture=replace(self.scene.capture, rig=self.rig(x)))

    def evaluate(self, objective: Objective, indices: Sequence[int], x: Vector) -> Point:
        """Loss, gradient and Gauss–Newton matrix of these frames: one picture with its tangents a frame."""
        found = [objective.products(*motion) for motion in self._motions(objective, indices, x)]
        return Point(
            x,
            np.array([p.loss for p in found]),
            np.array([p.slope for p in found]),
            np.mean([p.curvature for p in found], axis=0),
        )

    def gradient(self, objective: Objective, indices: Sequence[int], x: Vector) -> Vector:
        """`[K]`: the gradient of the mean loss alone, in less time than `evaluate`."""
        slopes = [objective.products(*motion, curvature=False).slope for motion in self._motions(objective, indices, x)]
        return np.asarray(np.mean(slopes, axis=0))

    def _motions(
        self, objective: Objective, indices: Sequence[int], x: Vector
    ) -> Iterator[tuple[int, Camera, SE3, list[Direction]]]:
        """A frame's index, its thermal camera at x, and how that camera changes with each of x."""
        here, s = self.scene_at(x), math.exp(x[0])
        ends = [[self.scene_at(x + sign * _DIFFERENCE * e) for sign in (-1, 1)] for e in np.eye(self.size)[1:]]
        for i in indices:
            name = objective.frames[i].name
            pose = here.thermal_from_world(name, s)
            directions = [scale_direction(here, x[0]), *(_direction(pair, name, s, pose) for pair in ends)]
            yield i, here.rig.thermal, pose, directions
            self.progress(f"calibration, s = {s:.5g}")

    def hessian(self, objective: Objective, indices: Sequence[int], x: Vector, steps: Vector) -> Vector:
        """`[K, K]`: of the mean loss, by central differences of its gradient with these steps `[K]`. Renders 2·K pictures a frame."""
        rows = []
        for e, h in zip(np.eye(self.size), steps, strict=True):
            after, before = (self.gradient(objective, indices, x + sign * h * e) for sign in (1, -1))
            rows.append((after - before) / (2 * h))
        matrix = np.array(rows)
        return (matrix + matrix.T) / 2

    def pixels(self, x: Vector, gaussians: Gaussians) -> Vector:
        """`[K]`: how far the picture moves per unit of each of x, in thermal pixels (90th percentile over the model's points)."""
        names = [f.name for f in self.scene.train_frames]
        names = names[:: -(-len(names) // 6)]
        means = gaussians.means.detach().double().cpu().numpy()
        points = means[np.random.default_rng(0).permutation(len(means))[:_POINTS]]
        moved: list[list[Vector]] = [[] for _ in range(self.size)]
        for name in names:
            before = _project(self.scene_at(x), name, x[0], points)
            seen = np.isfinite(before).all(axis=1)
            for k, e in enumerate(np.eye(self.size)):
                there = x + _DIFFERENCE * e
                moved[k].append((_project(self.scene_at(there), name, there[0], points) - before)[seen] / _DIFFERENCE)
        found = [float(np.nanpercentile(np.linalg.norm(np.concatenate(m), axis=1), 90)) for m in moved]
        return np.maximum(np.nan_to_num(found), _STILL)


def _direction(ends: Sequence[Scene], name: str, s: float, pose: SE3) -> Direction:
    """How a frame's thermal camera changes with one of u, from the scenes a little below and above: pose and intrinsics."""
    before, after = (scene.thermal_from_world(name, s) for scene in ends)
    width = 2 * _DIFFERENCE
    derivative = SE3((after.rotation - before.rotation) / width, (after.translation - before.translation) / width)
    cameras = [scene.rig.thermal for scene in ends]
    lens = {k: (getattr(cameras[1], k) - getattr(cameras[0], k)) / width for k in INTRINSICS}
    return replace(Direction.between(derivative, pose), **lens)


def _project(scene: Scene, name: str, theta: float, points: Vector) -> Vector:
    """`[P, 2]` pixels; NaN outside of the picture."""
    camera = scene.rig.thermal
    seen = scene.thermal_from_world(name, math.exp(theta)).apply(points)
    with np.errstate(all="ignore"):
        uv = camera.project(seen)
    inside = (seen[:, 2] > 0) & (np.abs(uv - [camera.width / 2, camera.height / 2]) < [camera.width / 2, camera.height / 2]).all(
        axis=1
    )
    return np.where(inside[:, None], uv, np.nan)
