"""Huber's loss in place of squares, by nonlinear conjugate gradients: for pixels that the geometry gets wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.fit_thermal.least_squares import Problem, dot, ratio

Floats = NDArray[np.float32]
CHUNKS = 16  # fixed parts of a photograph: each is summed by one thread, so the number of threads changes nothing


@dataclass(frozen=True, eq=False)
class RobustSolution:
    """`x` `[D, C]`; `iterations`; of each frame `[h, w, C]`: `shown`, design · x, and `weights`, the problem's times Huber's."""

    x: Tensor
    iterations: int
    shown: list[Tensor]
    weights: list[Tensor]


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
    misfits = [_Misfit(problem, f, image, columns) for f, image in zip(problem.frames, shown, strict=True)]
    total, _, squares = sum((m.moments(m.left - m.level[:, None]) for m in misfits), np.zeros((columns, 3))).T
    for misfit in misfits:
        misfit.bound = (huber * np.sqrt(squares / total.clip(1e-12))).clip(1e-12).astype(np.float32)
    x, done = start.expand(-1, columns).clone(), 0
    r, p, rz = torch.zeros_like(x), torch.zeros_like(x), torch.zeros(columns, dtype=torch.float64)
    while done < iterations:
        before, r = r, problem.ridge * (problem.prior - x)
        for misfit in misfits:
            design.add_transpose(misfit.frame, misfit.weighted(), r)
            each()
        z = problem.precondition(r)
        p = z + ratio(dot(r - before, z).clamp_min(0.0), rz).float() * p
        rz, curvature = dot(r, z), dot(p, problem.ridge * p)
        moves = [_planes(design.image(m.frame, p)) for m in misfits]
        for misfit, move in zip(misfits, moves, strict=True):
            curvature += misfit.curvature(move)
        step = ratio(dot(r, p), curvature).float()
        x += step * p
        for misfit, move in zip(misfits, moves, strict=True):
            misfit.left -= step.numpy()[:, None] * move
        done += 1
        if settled(x):
            break
    return RobustSolution(x, done, [m.shown() for m in misfits], [m.weights() for m in misfits])


class _Misfit:
    """What C problems side by side leave of a photograph, and how it counts.

    Attributes:
        left: `[C, h · w]`, photograph less design · x.
        bound: `[C]`, beyond which less counts.
        level: `[C]`, the frame's offset, from which the weights are told; 0 where a problem has none.
    """

    def __init__(self, problem: Problem, frame: int, shown: Tensor, columns: int) -> None:
        self.frame, self._photograph = frame, problem.images[frame]
        self._shape, self._given = shown.shape[:2], problem.weights[frame].numpy().ravel()
        left = _planes(self._photograph - shown)
        self.left = left if len(left) == columns else np.repeat(left, columns, axis=0)
        self._offsets = None if problem.offsets is None else problem.offsets.numpy()
        self.bound, self.level = np.full(columns, 1e30, np.float32), np.zeros(columns, np.float32)
        self.level = self._centre = self._mean()

    def moments(self, values: Floats) -> NDArray[np.float64]:
        """`[C, 3]`: Σ weights · (1, v, v²) of values `[C, h · w]`."""
        return np.asarray(_moments(self.left, self._given, self.level, self.bound, values).sum(axis=1))

    def weighted(self) -> Tensor:
        """`[h, w, C]`: new weights times what is left, the offset that suits them best taken out."""
        self.level = self._centre
        self._centre = self._mean()
        out = np.empty_like(self.left)
        _weigh(self.left, self._given, self.level, self.bound, self._centre, out)
        return self._picture(out)

    def curvature(self, move: Floats) -> Tensor:
        """`[C]`: Σ weights · move², less what the offset takes of it."""
        total, first, second = self.moments(move).T
        if self._offsets is not None:
            second = second - self._offsets * first**2 / total.clip(1e-12)
        return torch.from_numpy(second)

    def shown(self) -> Tensor:
        return self._photograph - self._picture(self.left)

    def weights(self) -> Tensor:
        away = np.abs(self.left - self._centre[:, None])
        return self._picture(self._given * (self.bound[:, None] / np.maximum(away, self.bound[:, None])))

    def _mean(self) -> Floats:
        if self._offsets is None:
            return self.level
        total, first, _ = self.moments(self.left).T
        return (self._offsets * first / total.clip(1e-12)).astype(np.float32)

    def _picture(self, planes: Floats) -> Tensor:
        return torch.from_numpy(planes.reshape(-1, *self._shape)).permute(1, 2, 0)


def _planes(image: Tensor) -> Floats:
    """`[C, h · w]` of `[h, w, C]`, which most often lies so."""
    return np.ascontiguousarray(image.permute(2, 0, 1).flatten(1).numpy())


@nb.njit(parallel=True, fastmath=True, cache=True)
def _moments(left: Floats, given: Floats, level: Floats, bound: Floats, values: Floats) -> NDArray[np.float64]:
    """`[C, CHUNKS, 3]`."""
    columns, pixels = left.shape
    out = np.zeros((columns, CHUNKS, 3))
    for chunk in nb.prange(CHUNKS):
        for c in range(columns):
            total, first, second = np.float32(0), np.float32(0), np.float32(0)
            for i in range(pixels * chunk // CHUNKS, pixels * (chunk + 1) // CHUNKS):
                w = given[i] * (bound[c] / max(abs(left[c, i] - level[c]), bound[c]))
                total += w
                first += w * values[c, i]
                second += w * values[c, i] * values[c, i]
            out[c, chunk] = total, first, second
    return out


@nb.njit(parallel=True, fastmath=True, cache=True)
def _weigh(left: Floats, given: Floats, level: Floats, bound: Floats, centre: Floats, out: Floats) -> None:
    columns, pixels = left.shape
    for chunk in nb.prange(CHUNKS):
        for c in range(columns):
            for i in range(pixels * chunk // CHUNKS, pixels * (chunk + 1) // CHUNKS):
                w = given[i] * (bound[c] / max(abs(left[c, i] - level[c]), bound[c]))
                out[c, i] = w * (left[c, i] - centre[c])
