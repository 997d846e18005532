"""Huber's loss in place of squares, by nonlinear conjugate gradients: for pixels that the geometry gets wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.fit_thermal.design import Design
from rtgs.fit_thermal.least_squares import Problem, dot, picture_of, planes_of, ratio
from rtgs.render.cpu.planes import Planes, add_each

SMALLEST_BOUND = 1e-4  # of the range: a start that fits exactly says nothing of how large errors are


@dataclass(frozen=True, eq=False)
class RobustSolution:
    """`x` `[D, C]`, and what it leaves of the photographs."""

    x: Tensor
    _misfits: Mapping[int, _Misfit]

    def shown(self, frame: int) -> Tensor:
        """`[h, w, C]`: design · x of one of the problem's frames."""
        return self._misfits[frame].shown()

    def weights(self, frame: int) -> Tensor:
        """`[h, w, C]`: the problem's, times Huber's."""
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
    """From `start` `[D, 1 or C]`; as `solve`, but that a residual counts by its square up to `huber` times the root mean square of all at
    the start, and beyond by its size.

    Each step is as long as suits the quadratic that touches the loss where the step begins and is nowhere below it (that of reweighted
    least squares): no step raises the loss. Directions are Polak and Ribière's.

    Args:
        problem: without a surface. Its weights are multiplied by Huber's.
        shown: `[h, w, 1 or C]`, design · start of each of the problem's frames.
        iterations, settled, each: as of `solve`.
    """
    if problem.surface is not None:
        raise ValueError("solve_robustly: a common surface is for `solve`.")
    design, columns = problem.design, problem.ridge.shape[1]
    misfits = {f: _Misfit(problem, f, image, columns) for f, image in zip(problem.frames, shown, strict=True)}
    total, _, squares = sum((m.moments(m.left - m.level[:, None]) for m in misfits.values()), np.zeros((columns, 3))).T
    for misfit in misfits.values():
        misfit.bound = (huber * np.sqrt(squares / total.clip(1e-12))).clip(SMALLEST_BOUND).astype(np.float32)
    x = start.expand(-1, columns).clone()
    r, p, rz = torch.zeros_like(x), torch.zeros_like(x), torch.zeros(columns, dtype=torch.float64)
    for _ in range(iterations):
        before, r = r, problem.ridge * (problem.prior - x)
        design.add_transpose(lambda f: misfits[f].weighted(), problem.frames, r, each)
        z = problem.precondition(r)
        p = z + ratio(dot(r - before, z).clamp_min(0.0), rz).float() * p
        rz, curvature = dot(r, z), dot(p, problem.ridge * p)
        with closing(design.each(partial(_curvature, misfits, design, p), problem.frames)) as parts:
            for of_frame in parts:
                curvature += of_frame
        step = ratio(dot(r, p), curvature).float()
        x += step * p
        for _frame in design.each(partial(_go, misfits, step.numpy()), problem.frames):
            pass
        if settled(x) or bool((rz == 0).all()):
            break
    return RobustSolution(x, misfits)


def _curvature(misfits: Mapping[int, _Misfit], design: Design, p: Tensor, frame: int) -> Tensor:
    return misfits[frame].curvature(planes_of(design.image(frame, p)))


def _go(misfits: Mapping[int, _Misfit], step: Planes, frame: int) -> None:
    misfits[frame].go(step)


class _Misfit:
    """What C problems side by side leave of a photograph, and how it counts.

    Attributes:
        left: `[C, h · w]`, photograph less design · x.
        bound: `[C]`, beyond which less counts.
        level: `[C]`, the offset by which the weights are told; 0 where a problem has none.
    """

    def __init__(self, problem: Problem, frame: int, shown: Tensor, columns: int) -> None:
        self._photograph = problem.images[frame]
        self._shape, self._given = shown.shape[:2], problem.weights[frame].numpy().ravel()
        left = planes_of(self._photograph - shown)
        self.left = left if len(left) == columns else np.repeat(left, columns, axis=0)
        self._offsets = None if problem.offsets is None else problem.offsets.numpy()
        self.bound, self.level = np.full(columns, 1e30, np.float32), np.zeros(columns, np.float32)
        self.level = self._mean()
        self._centre, self._move, self._shift = self.level, self.left[:, :0], self.level

    def moments(self, values: Planes) -> NDArray[np.float64]:
        """`[C, 3]`: Σ weights · (1, v, v²) of values `[C, h · w]`."""
        return np.asarray(_moments(self.left, self._given, self.level, self.bound, values))

    def weighted(self) -> Tensor:
        """`[h, w, C]`: new weights times what is left, the offset that suits them best taken out."""
        self.level = self._centre
        if self._offsets is not None:
            self._centre = self._mean()
        out = np.empty_like(self.left)
        _weigh(self.left, self._given, self.level, self.bound, self._centre, out)
        return picture_of(out, self._shape)

    def curvature(self, move: Planes) -> Tensor:
        """`[C]`: Σ weights · move², less what the offset takes of it; remembers the move, `[C, h · w]`."""
        self._move = move
        total, first, second = self.moments(move).T
        if self._offsets is not None:
            shift = self._offsets * first / total.clip(1e-12)
            second, self._shift = second - shift * first, shift.astype(np.float32)
        return torch.from_numpy(second)

    def go(self, step: Planes) -> None:
        """The remembered move, so far; the offset that suits goes with it."""
        add_each(self.left, -step, self._move)
        self._centre = self._centre - step * self._shift

    def shown(self) -> Tensor:
        return self._photograph - picture_of(self.left, self._shape)

    def weights(self) -> Tensor:
        away = np.abs(self.left - self._centre[:, None])
        return picture_of(self._given * (self.bound[:, None] / np.maximum(away, self.bound[:, None])), self._shape)

    def _mean(self) -> Planes:
        if self._offsets is None:
            return np.zeros_like(self.level)
        total, first, _ = self.moments(self.left).T
        return (self._offsets * first / total.clip(1e-12)).astype(np.float32)


@nb.njit(nogil=True, fastmath=True, cache=True, error_model="numpy")
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


@nb.njit(nogil=True, fastmath=True, cache=True, error_model="numpy")
def _weigh(left: Planes, given: Planes, level: Planes, bound: Planes, centre: Planes, out: Planes) -> None:
    for c in range(len(left)):
        for i in range(left.shape[1]):
            w = given[i] * (bound[c] / max(abs(left[c, i] - level[c]), bound[c]))
            out[c, i] = w * (left[c, i] - centre[c])
