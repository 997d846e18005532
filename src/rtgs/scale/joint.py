"""The loss as a function of the scale and the calibration together, with its gradient and curvatures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.maths.geometry import SE3
from rtgs.records.gaussians import Gaussians
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.renderer import Direction
from rtgs.scale.objective import Objective
from rtgs.scale.records import Counter
from rtgs.scale.unknowns import Unknown

Vector = NDArray[np.float64]

_DIFFERENCE = 1e-4  # of a prior's standard deviation, for the poses' derivatives
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
        return self.gradients.mean(axis=0)


class Joint:
    """L(θ, u) of a scene's frames: u are the unknowns' amounts in standard deviations of their priors."""

    def __init__(self, scene: Scene, found: Sequence[Unknown], counter: Counter) -> None:
        self.scene, self.unknowns, self.counter = scene, tuple(found), counter
        self.size = 1 + len(found)
        self.prior = np.diag([0.0, *np.ones(len(found))])  # P: precision; nothing is known about θ

    def rig(self, x: Vector) -> Rig:
        rig = self.scene.rig
        for unknown, u in zip(self.unknowns, x[1:], strict=True):
            rig = unknown.change(rig, float(u) * unknown.std)
        return rig

    def scene_at(self, x: Vector) -> Scene:
        return replace(self.scene, capture=replace(self.scene.capture, rig=self.rig(x)))

    def evaluate(self, objective: Objective, indices: Sequence[int], x: Vector) -> Point:
        """One picture with its tangents a frame."""
        here, s = self.scene_at(x), math.exp(x[0])
        ends = [[self.scene_at(x + sign * _DIFFERENCE * e) for sign in (-1, 1)] for e in np.eye(self.size)]
        scales = [[math.exp(x[0] + sign * _DIFFERENCE * e[0]) for sign in (-1, 1)] for e in np.eye(self.size)]
        found = []
        for i in indices:
            name = objective.frames[i].name
            pose = here.thermal_from_world(name, s)
            ways = [_way(pair, at, name, pose) for pair, at in zip(ends, scales, strict=True)]
            found.append(objective.products_from(i, here.rig.thermal, pose, ways))
            self.counter(f"joint refinement, s = {s:.5g}")
        return Point(
            x,
            np.array([p.loss for p in found]),
            np.array([p.slope for p in found]),
            np.mean([p.curvature for p in found], axis=0),
        )

    def pixels(self, x: Vector, gaussians: Gaussians) -> Vector:
        """`[K]`: how far the picture moves per unit of each of x, in thermal pixels (90th percentile over the model's points)."""
        names = [f.name for f in self.scene.train_frames]
        names = names[:: -(-len(names) // 6)]
        means = gaussians.means.detach().to(torch.float64).cpu().numpy()
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

    def hessian(self, objective: Objective, indices: Sequence[int], x: Vector, steps: Vector) -> Vector:
        """`[K, K]`: of the mean loss, by central differences of its gradient."""
        rows = []
        for e, h in zip(np.eye(self.size), steps, strict=True):
            after, before = (self.evaluate(objective, indices, x + sign * h * e).gradient for sign in (1, -1))
            rows.append((after - before) / (2 * h))
        matrix = np.array(rows)
        return (matrix + matrix.T) / 2


def _way(ends: Sequence[Scene], scales: Sequence[float], name: str, pose: SE3) -> Direction:
    before, after = (scene.thermal_from_world(name, s) for scene, s in zip(ends, scales, strict=True))
    derivative = SE3(
        (after.rotation - before.rotation) / (2 * _DIFFERENCE), (after.translation - before.translation) / (2 * _DIFFERENCE)
    )
    lens = {k: (getattr(ends[1].rig.thermal, k) - getattr(ends[0].rig.thermal, k)) / (2 * _DIFFERENCE) for k in ("fl_x", "fl_y")}
    return replace(Direction.between(derivative, pose), **lens)


def _project(scene: Scene, name: str, theta: float, points: Vector) -> Vector:
    """`[P, 2]` pixels; NaN outside of the picture."""
    camera = scene.rig.thermal
    x, y, z = scene.thermal_from_world(name, math.exp(theta)).apply(points).T
    with np.errstate(all="ignore"):
        uv = np.stack([camera.fl_x * x / z + camera.cx, camera.fl_y * y / z + camera.cy], axis=1)
    inside = (z > 0) & (np.abs(uv - [camera.width / 2, camera.height / 2]) < [camera.width / 2, camera.height / 2]).all(axis=1)
    return np.where(inside[:, None], uv, np.nan)
