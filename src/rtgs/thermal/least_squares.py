"""Weighted least squares with a ridge, by preconditioned conjugate gradients on the normal equations.

All solves are multi-right-hand-side solves: C problems that share the design matrix are solved together, one column each. They may
differ in ridge, offsets and surface. Most of the work, the weights of the design, is done once for all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from rtgs.maths.planes import Planes, products
from rtgs.thermal.design import Design


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """Find x that minimises Σ_f weights_f · (image_f − design_f · x − offset_f − surface)² + Σ ridge · (x − prior)², for C columns x.

    Offsets and the surface are free and eliminated exactly. An offset is the weighted mean of a frame's residual. The surface is one
    linear combination of B given ones, the same in all frames.

    Attributes:
        frames: indices of the frames that count.
        images, weights: `[h, w, 1 or C]` and `[h, w]`, of all frames of the design.
        offsets: `[C]`, 1 for a column in which each frame has an offset, 0 where it has none; None: 0 everywhere.
        surface: `[h, w, B]`; None: no surface. Its weighted mean must be 0, and all frames must have the same weights.
        surfaces: `[C]`, 1 for a column that has the surface; None: 1 everywhere.
        ridge, prior: `[D, C]`.
        inverses, background: the preconditioner, `[N, K, K]` and a number (see `preconditioner`).
    """

    design: Design
    frames: Sequence[int]
    images: Sequence[Tensor]
    weights: Sequence[Tensor]
    offsets: Tensor | None
    ridge: Tensor
    prior: Tensor
    inverses: Tensor
    background: float
    surface: Tensor | None = None
    surfaces: Tensor | None = None

    def gradient(self, x: Tensor, each: Callable[[], None] = lambda: None) -> Tensor:
        """`[D, C]`: the negative gradient at x, halved.

        Args:
            each: called after each frame.
        """
        out = self.ridge * (self.prior - x)
        self._add_transpose(lambda f: planes_of(self.images[f]) - planes_of(self.design.image(f, x)), out, each)
        return out

    def normal(self, p: Tensor, each: Callable[[], None] = lambda: None) -> Tensor:
        """`[D, C]`: (designᵀ · weights · design + ridge) · p, offsets and surface eliminated."""
        out = self.ridge * p
        self._add_transpose(lambda f: planes_of(self.design.image(f, p)), out, each)
        return out

    def precondition(self, r: Tensor) -> Tensor:
        """`[D, C]`: the preconditioner's inverse · r."""
        z = r / self.background
        self.design.harmonics(z).copy_(torch.bmm(self.inverses, self.design.harmonics(r)))
        return z

    def _add_transpose(self, draw: Callable[[int], Planes], out: Tensor, each: Callable[[], None]) -> None:
        """out += designᵀ · weights · (the planes `draw` returns, with their best offsets and surface subtracted)."""
        surface = None if self.surface is None else planes_of(self.surface)
        amounts: dict[int, Planes] = {}

        def weighted(f: int) -> Tensor:
            planes = self._weighted(f, draw(f))
            if surface is not None:
                amounts[f] = products(surface, planes)
            return picture_of(planes, self.weights[f].shape)

        self.design.add_transpose(weighted, self.frames, out, each)
        if self.surface is not None:
            inverse, transposed = self._eliminated
            amount = inverse @ torch.from_numpy(sum(amounts[f] for f in self.frames))
            out -= transposed @ (amount if self.surfaces is None else amount * self.surfaces)

    @cached_property
    def _eliminated(self) -> tuple[Tensor, Tensor]:
        """The inverse of the surface's normal matrix `[B, B]`, and Σ_f designᵀ · weights · surface `[D, B]`."""
        assert self.surface is not None
        if any(self.weights[f] is not self.weights[self.frames[0]] for f in self.frames):
            raise ValueError("Problem: with a common surface, all frames must have the same weights.")
        weighted = self.surface * self.weights[self.frames[0]][..., None]
        normal = len(self.frames) * torch.einsum("hwb,hwc->bc", self.surface, weighted)
        transposed = torch.zeros(self.design.size, self.surface.shape[2])
        self.design.add_transpose(lambda f: weighted, self.frames, transposed)
        return torch.linalg.pinv(normal, hermitian=True), transposed

    def _weighted(self, frame: int, planes: Planes) -> Planes:
        """Weights · planes; in columns with offsets, the weighted mean is subtracted first."""
        weights = self.weights[frame].numpy().reshape(1, -1)
        if self.offsets is None:
            return weights * planes
        means = self.offsets.numpy() * products(weights, planes)[0] / max(float(weights.sum()), 1e-12)
        weighted = planes - means[:, None].astype(np.float32)
        weighted *= weights
        return weighted


def planes_of(image: Tensor) -> Planes:
    """`[C, h · w]` of `[h, w, C]`: a view if channels are contiguous, else a copy."""
    return np.ascontiguousarray(image.permute(2, 0, 1).flatten(1).numpy())


def picture_of(planes: Planes, shape: Sequence[int]) -> Tensor:
    """`[h, w, C]` of `[C, h · w]`."""
    return torch.from_numpy(planes.reshape(-1, *shape)).permute(1, 2, 0)


def preconditioner(blocks: Tensor, background: float, ridge: Tensor, design: Design) -> tuple[Tensor, float]:
    """`Problem.inverses` `[N, K, K]` and `Problem.background`: block-Jacobi with column sums, as SIRT has them in tomography.

    A Gaussian's block is Σ_views (Σ_pixels weight) · basis ⊗ basis. It has the *sum* of the Gaussian's weights, not of their squares.
    A pixel's weights add up to one, so the sums bound WᵀW from above. With squares, each of the Gaussians that share a pixel would
    try to explain all of its residual.

    Args:
        blocks: `[N, K, K]`, the Gaussians' blocks.
        background: the sum of the background's weights.
        ridge: `[D]`.
    """
    return torch.linalg.inv(blocks + torch.diag_embed(design.harmonics(ridge))), background + float(ridge[-1])


@dataclass(frozen=True, eq=False)
class Solution:
    """What a solver found.

    Attributes:
        x: `[D, C]`.
        iterations: how many were made.
        settled: whether it ended by itself, by `settled` or because nothing was left to do, and not by the number of iterations.
        residual: `[C]`, the last gradient computed as a share of the first, in the preconditioner's norm √(rᵀ M⁻¹ r).
    """

    x: Tensor
    iterations: int
    settled: bool
    residual: Tensor


def solve(
    problem: Problem,
    start: Tensor,
    *,
    iterations: int,
    settled: Callable[[Tensor], bool] = lambda x: False,
    each: Callable[[], None] = lambda: None,
) -> Solution:
    """Preconditioned conjugate gradients from `start` `[D, C]`. Nothing is kept of the frames from one iteration to the next.

    Args:
        iterations: the most that are made.
        settled: called with the unknowns `[D, C]` after each iteration; True ends the solve.
        each: called after each frame of each pass.
    """
    x = start.clone()
    r = problem.gradient(x, each)
    z = problem.precondition(r)
    p, rz = z.clone(), dot(r, z)
    first, done, ended = rz, 0, False
    while done < iterations and not ended:
        q = problem.normal(p, each)
        step = ratio(rz, dot(p, q)).float()
        x += step * p
        r -= step * q
        z = problem.precondition(r)
        old, rz = rz, dot(r, z)
        done += 1
        ended = settled(x) or bool((rz == 0).all())
        if not ended:
            p = z + ratio(rz, old).float() * p
    return Solution(x, done, ended, ratio(rz, first).sqrt().float())


def dot(a: Tensor, b: Tensor) -> Tensor:
    """`[C]` in float64, without a float64 copy of the vectors."""
    return (a * b).sum(0, dtype=torch.float64)


def ratio(a: Tensor, b: Tensor) -> Tensor:
    """a / b, and 0 where b is 0, so that a column that is solved stays as it is."""
    return torch.where(b > 0, a / b.clamp_min(torch.finfo(torch.float64).tiny), torch.zeros_like(a))
