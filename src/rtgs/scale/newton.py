"""Newton's method for the scale and the calibration together, coarse to fine."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtgs.records.scene import Scene
from rtgs.scale.objective import Objective
from rtgs.scale.posterior import best_weight, bias, covariance, gradient_covariance, positive
from rtgs.scale.rig_loss import Point, RigLoss, Vector
from rtgs.scale.thermal_targets import Pictures, halvings, some_of

_HESSIAN_PIXELS = 0.5
_HESSIAN_FRAMES = 16
_MOST_STEPS = 6
_MOST_HESSIANS = 3
_LONGEST = 2.0  # pixels of the size compared
_TOLERANCE = 0.02  # pixels of the size compared


@dataclass(frozen=True, eq=False)
class JointSolution:
    """Where the joint descent ended.

    Attributes:
        x: `[K]`. covariance: `[F, F]` of what was free. response: `[F, Q]`, its derivative by what was held.
        pixels: `[K]`, how far the picture moves per unit of x.
        renders: how many pictures were rendered.
    """

    x: Vector
    covariance: Vector
    response: Vector
    pixels: Vector
    renders: int


@dataclass(frozen=True, eq=False)
class _Merit:
    """F(x) = L(x) + w/2 · uᵀu at one size, and what a step needs to know of it.

    Attributes:
        frames: indices of the objective's frames. free: `[K]`, which of x move.
        curvature: `[F, F]` of F, among what is free. weight: w.
        pixels: `[K]`, how far the picture moves per unit of x, in pixels of this size.
    """

    loss: RigLoss
    objective: Objective
    frames: Sequence[int]
    free: NDArray[np.bool_]
    curvature: Vector
    weight: float
    pixels: Vector

    def at(self, point: Point) -> float:
        """F at a point."""
        return float(point.losses.mean()) + self.weight / 2 * float(point.x[1:] @ point.x[1:])

    def step(self, here: Point) -> Vector:
        """`[K]`: Newton's step, cut to the longest that is allowed."""
        slope = here.gradient + self.weight * self.loss.prior @ here.x
        step = np.zeros(self.loss.size)
        step[self.free] = -np.linalg.solve(self.curvature, slope[self.free])
        return step * min(1.0, _LONGEST / max(self.moves(step), 1e-12))

    def moves(self, step: Vector) -> float:
        """Pixels by which a step moves the picture."""
        return float(np.abs(step * self.pixels).max())

    def descend(self, here: Point) -> tuple[Point, int]:
        """Newton's steps with one matrix, taken where they lower F: where they end, and how often F was evaluated."""
        evaluations = 0

        def evaluate(x: Vector) -> Point:
            nonlocal evaluations
            evaluations += 1
            return self.loss.evaluate(self.objective, self.frames, x)

        for _ in range(_MOST_STEPS):
            step = self.step(here)
            there = evaluate(here.x + step)
            while self.at(there) >= self.at(here) and self.moves(step) > _TOLERANCE:
                step = step / 3
                there = evaluate(here.x + step)
            if self.at(there) >= self.at(here):
                break
            here = there
            if self.moves(step) <= _TOLERANCE:
                break
        return here, evaluations


def solve_jointly(loss: RigLoss, pictures: Pictures, theta: float, free: NDArray[np.bool_]) -> JointSolution:
    """Descend F(x) = L(x) + w/2 · uᵀu by Newton's steps from (θ, 0), coarse to fine.

    Args:
        free: `[K]`, which of x move; the others are held at the calibration's value.
    """
    x = np.zeros(loss.size)
    x[0] = theta
    every = range(len(pictures.frames))
    few = some_of(every, _HESSIAN_FRAMES)
    prior = loss.prior[np.ix_(free, free)]
    pixels = loss.pixels(x, pictures.model.gaussians)
    coarsest, renders = _coarsest(pictures.scene, pixels, free), 0
    loss.progress.plan(4 * (coarsest + 1) * loss.size * len(few) + 6 * len(every))
    for halved in range(coarsest, -1, -1):
        objective, coarse_pixel = pictures.objective(halved), 2.0**halved
        indices = few if halved else every
        here = loss.evaluate(objective, indices, x)
        renders += len(indices)
        for _ in range(_MOST_HESSIANS):
            began = x
            hessian = loss.hessian(objective, few, x, np.minimum(_HESSIAN_PIXELS * coarse_pixel / pixels, 1.0))
            curved = positive(hessian[np.ix_(free, free)], here.gauss_newton[np.ix_(free, free)])
            scatter = gradient_covariance(here.gradients[:, free]) + bias(curved, pixels[free], pictures.blur_px)
            weight = best_weight(curved, scatter, prior)
            merit = _Merit(loss, objective, indices, free, curved + weight * prior, weight, pixels / coarse_pixel)
            here, evaluations = merit.descend(here)
            renders += 2 * loss.size * len(few) + evaluations * len(indices)
            x = here.x
            if np.abs((x - began) * pixels).max() < _HESSIAN_PIXELS * coarse_pixel:
                break
    response = np.asarray(-np.linalg.solve(curved + weight * prior, hessian[np.ix_(free, ~free)]), dtype=np.float64)
    return JointSolution(x, covariance(curved, scatter, prior, weight), response, pixels, renders)


def _coarsest(scene: Scene, pixels: Vector, free: NDArray[np.bool_]) -> int:
    """How often the picture is halved at first: until two standard deviations of the priors together move it by two pixels or less."""
    reach = 2 * float(np.linalg.norm(pixels[1:][free[1:]]))
    return min(halvings(scene), max(0, math.ceil(math.log2(max(reach, 1.0) / 2))))
