"""Huber's loss in place of squares, by nonlinear conjugate gradients. It bounds the influence of pixels that the geometry gets wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.base.compiled import kernel
from rtgs.maths.planes import Planes, add_each
from rtgs.thermal.design import Design
from rtgs.thermal.least_squares import Problem, Solution, dot, picture_of, planes_of, ratio

SMALLEST_BOUND = 1e-4  # of the range, for a start that fits exactly: its residuals do not show how large errors are


@dataclass(frozen=True, eq=False)
class RobustSolution(Solution):
    """A `Solution` with its images and Huber weights. `residual` is from before the last step, where the last gradient was computed."""

    _misfits: Mapping[int, _Misfit]

    def shown(self, frame: int) -> Tensor:
        """`[h, w, C]`: design · x in one of the problem's frames."""
        return self._misfits[frame].shown()

    def weights(self, frame: int) -> Tensor:
        """`[h, w, C]`: the problem's weights times Huber's."""
        return self._misfits[frame].weights()


def solve_robustly(
    problem: Problem,
    start: Tensor,
    *,
    huber: float,
    iterations: int,
    shown: Sequence[Tensor],
    settled: Callable[[Tensor], bool] = lambda x: False,
    each: Callable[[], None] = lambda: None,
) -> RobustSolution:
    """Minimise Huber's loss from `start` `[D, 1 or C]`.

    A residual counts by its square up to a bound, and beyond by its size. The bound is `huber` times the root mean square of all
    residuals at the start. Each step minimises, along its direction, the quadratic of iteratively reweighted least squares. That
    quadratic touches the loss where the step begins and is nowhere below it, so no step raises the loss. Directions are Polak and
    Ribière's.

    Args:
        problem: without a surface. Its weights are multiplied by Huber's.
        shown: `[h, w, 1 or C]`, design · start in each of the problem's frames.
        iterations, settled, each: as of `solve`.

    Raises:
        ValueError: the problem has a surface.
    """
    if problem.surface is not None:
        raise ValueError("solve_robustly: the problem has a common surface; only `solve` can eliminate one.")
    design, columns = problem.design, problem.ridge.shape[1]
    misfits = {f: _Misfit(problem, f, image, columns) for f, image in zip(problem.frames, shown, strict=True)}
    total, _, squares = sum((m.moments(m.left - m.level[:, None]) for m in misfits.values()), np.zeros((columns, 3))).T
    for misfit in misfits.values():
        misfit.bound = (huber * np.sqrt(squares / total.clip(1e-12))).clip(SMALLEST_BOUND).astype(np.float32)
    x = start.expand(-1, columns).clone()
    r, p, rz = torch.zeros_like(x), torch.zeros_like(x), torch.zeros(columns, dtype=torch.float64)
    first, done, ended = rz, 0, False
    while done < iterations and not ended:
        before, r = r, problem.ridge * (problem.prior - x)
        design.add_transpose(lambda f: misfits[f].weighted(), problem.frames, r, each)
        z = problem.precondition(r)
        p = z + ratio(dot(r - before, z).clamp_min(0.0), rz).float() * p
        rz, curvature = dot(r, z), dot(p, problem.ridge * p)
        first = first if done else rz
        with closing(design.each(partial(_curvature, misfits, design, p), problem.frames)) as parts:
            for of_frame in parts:
                curvature += of_frame
        step = ratio(dot(r, p), curvature).float()
        x += step * p
        for misfit in misfits.values():
            misfit.go(step.numpy())
        done += 1
        ended = settled(x) or bool((rz == 0).all())
    return RobustSolution(x, done, ended, ratio(rz, first).sqrt().float(), misfits)


def _curvature(misfits: Mapping[int, _Misfit], design: Design, p: Tensor, frame: int) -> Tensor:
    return misfits[frame].curvature(planes_of(design.image(frame, p)))


class _Misfit:
    """Residuals of one photograph in C columns, and their Huber weights.

    Attributes:
        left: `[C, h · w]`, photograph − design · x.
        bound: `[C]`, bound of Huber's loss.
        level: `[C]`, the frame's offset when the weights were computed; 0 in columns without offsets.
    """

    def __init__(self, problem: Problem, frame: int, shown: Tensor, columns: int) -> None:
        self._photograph = problem.images[frame]
        self._shape, self._given = shown.shape[:2], problem.weights[frame].numpy().ravel()
        left = planes_of(self._photograph - shown)
        self.left = left if len(left) == columns else np.repeat(left, columns, axis=0)
        nothing = np.zeros(columns, np.float32)
        self._offsets = nothing if problem.offsets is None else problem.offsets.numpy()
        self.bound, self.level = np.full(columns, 1e30, np.float32), nothing
        self.level = _mean(self.left, self._given, nothing, self.bound, self._offsets)
        self._centre, self._move, self._step, self._shift = self.level, self.left, nothing, nothing

    def moments(self, values: Planes) -> NDArray[np.float64]:
        """`[C, 3]`: Σ weights · (1, v, v²) of values `[C, h · w]`."""
        return np.asarray(_moments(self.left, self._given, self.level, self.bound, values))

    def weighted(self) -> Tensor:
        """`[h, w, C]`: new weights · (residual − its weighted mean, in columns with offsets). Carries out the step that is pending."""
        out = np.empty_like(self.left)
        step, self._step = self._step, np.zeros_like(self._step)
        self.level = self._centre
        self._centre = _weigh(self.left, step, self._move, self._given, self.level, self.bound, self._offsets, out)
        return picture_of(out, self._shape)

    def curvature(self, move: Planes) -> Tensor:
        """`[C]`: Σ weights · move², offsets eliminated. Remembers the move `[C, h · w]` for `go`."""
        self._move = move
        total, first, second = self.moments(move).T
        shift = self._offsets * first / total.clip(1e-12)
        self._shift = shift.astype(np.float32)
        return torch.from_numpy(second - shift * first)

    def go(self, step: Planes) -> None:
        """Make the remembered move by `step` `[C]`, together with its offset; carried out when residuals are next needed."""
        self._step, self._centre = step, self._centre - step * self._shift

    def shown(self) -> Tensor:
        return self._photograph - picture_of(self._now(), self._shape)

    def weights(self) -> Tensor:
        away = np.abs(self._now() - self._centre[:, None])
        return picture_of(self._given * (self.bound[:, None] / np.maximum(away, self.bound[:, None])), self._shape)

    def _now(self) -> Planes:
        return self.left - self._step[:, None] * self._move


@kernel("fastest", concurrent=True)
def _moments(left: Planes, given: Planes, level: Planes, bound: Planes, values: Planes) -> NDArray[np.float64]:
    out = np.empty((len(left), 3))
    for c in range(len(left)):
        total, first, second = np.float32(0), np.float32(0), np.float32(0)
        for i in range(left.shape[1]):
            w = given[i] * (bound[c] / max(abs(left[c, i] - level[c]), bound[c]))
            total += w
            first += w * values[c, i]
            second += w * values[c, i] * values[c, i]
        out[c] = total, first, second
    return out


@kernel("fastest", concurrent=True)
def _mean(left: Planes, given: Planes, level: Planes, bound: Planes, offsets: Planes) -> Planes:
    """`[C]`: the weighted mean of the residuals; 0 in columns without offsets."""
    out = np.zeros(len(left), np.float32)
    if offsets.any():
        for c, (total, first, _) in enumerate(_moments(left, given, level, bound, left)):
            out[c] = offsets[c] * first / max(total, 1e-12)
    return out


@kernel("fastest", concurrent=True)
def _weigh(
    left: Planes, step: Planes, move: Planes, given: Planes, level: Planes, bound: Planes, offsets: Planes, out: Planes
) -> Planes:
    """left −= step · move, then out = weights · (left − its mean). Returns the mean `[C]`."""
    add_each(left, -step, move)
    centre = _mean(left, given, level, bound, offsets)
    for c in range(len(left)):
        for i in range(left.shape[1]):
            w = given[i] * (bound[c] / max(abs(left[c, i] - level[c]), bound[c]))
            out[c, i] = w * (left[c, i] - centre[c])
    return centre
