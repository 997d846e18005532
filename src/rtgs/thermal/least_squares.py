"""Weighted least squares with a ridge, by preconditioned conjugate gradients on the normal equations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from rtgs.maths.planes import Planes, products
from rtgs.thermal.design import Design


@dataclass(frozen=True, eq=False)
class Problem:
    """Least x of Σ_f ‖image_f − design_f · x − offset_f‖² + Σ ridge · (x − prior)², each pixel weighed, C times side by side.

    Offsets, where a problem has any, are eliminated exactly: the weighted mean is taken out of every residual. So is a surface that all
    frames have in common.

    Attributes:
        frames: indices of those that count.
        images, weights: `[h, w, 1 or C]` and `[h, w]`, of all frames of the design.
        offsets: `[C]`, 1 for a problem in which each frame has an offset of its own, 0 where they are 0; None: 0 everywhere.
        surface: `[h, w, B]`, of which all frames may have any one combination added; None: none. Only where all frames have the same
            weights, by which its mean is 0.
        surfaces: `[C]`, 1 for a problem that has it; None: 1 everywhere.
        ridge, prior: `[D, C]`.
        inverses, background: the preconditioner (see `preconditioner`).
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
        """Half the direction of descent `[D, C]`."""
        out = self.ridge * (self.prior - x)
        self._add_transpose(lambda f: planes_of(self.images[f]) - planes_of(self.design.image(f, x)), out, each)
        return out

    def normal(self, p: Tensor, each: Callable[[], None] = lambda: None) -> Tensor:
        """(designᵀ · weights · design + ridge) · p."""
        out = self.ridge * p
        self._add_transpose(lambda f: planes_of(self.design.image(f, p)), out, each)
        return out

    def precondition(self, r: Tensor) -> Tensor:
        z = r / self.background
        self.design.harmonics(z).copy_(torch.bmm(self.inverses, self.design.harmonics(r)))
        return z

    def _add_transpose(self, draw: Callable[[int], Planes], out: Tensor, each: Callable[[], None]) -> None:
        """out += designᵀ · weights · (what is drawn less what offsets and surface would make of it)."""
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
        """Of the surface: the inverse of its normal matrix `[B, B]`, and Σ_f designᵀ · weights · surface `[D, B]`."""
        assert self.surface is not None
        if any(self.weights[f] is not self.weights[self.frames[0]] for f in self.frames):
            raise ValueError("Problem: a common surface wants the same weights for all frames.")
        weighted = self.surface * self.weights[self.frames[0]][..., None]
        normal = len(self.frames) * torch.einsum("hwb,hwc->bc", self.surface, weighted)
        transposed = torch.zeros(self.design.size, self.surface.shape[2])
        self.design.add_transpose(lambda f: weighted, self.frames, transposed)
        return torch.linalg.pinv(normal, hermitian=True), transposed

    def _weighted(self, frame: int, planes: Planes) -> Planes:
        """Weights · (planes less their weighted means, where there are offsets)."""
        weights = self.weights[frame].numpy().reshape(1, -1)
        if self.offsets is None:
            return weights * planes
        means = self.offsets.numpy() * products(weights, planes)[0] / max(float(weights.sum()), 1e-12)
        weighted = planes - means[:, None].astype(np.float32)
        weighted *= weights
        return weighted


def planes_of(image: Tensor) -> Planes:
    """`[C, h · w]` of `[h, w, C]`: a view, if it lies channel by channel."""
    return np.ascontiguousarray(image.permute(2, 0, 1).flatten(1).numpy())


def picture_of(planes: Planes, shape: Sequence[int]) -> Tensor:
    """`[h, w, C]` of `[C, h · w]`."""
    return torch.from_numpy(planes.reshape(-1, *shape)).permute(1, 2, 0)


def preconditioner(blocks: Tensor, background: float, ridge: Tensor, design: Design) -> tuple[Tensor, float]:
    """`Problem.inverses` `[N, K, K]` and `Problem.background`.

    A Gaussian's block is Σ_views (Σ_pixels weight) · basis ⊗ basis: the *sum* of what it contributes to pixels, not of its square.
    A pixel's weights add up to one, so column sums bound WᵀW from above (as SIRT has it in tomography); squares alone would tell each of
    the Gaussians that share a pixel to explain all of its residual.

    Args:
        blocks: `[N, K, K]`. background: likewise, a number. ridge: `[D]`.
    """
    return torch.linalg.inv(blocks + torch.diag_embed(design.harmonics(ridge))), background + float(ridge[-1])


def solve(
    problem: Problem,
    start: Tensor,
    *,
    iterations: int,
    settled: Callable[[Tensor], bool] = lambda x: False,
    each: Callable[[], None] = lambda: None,
) -> Tensor:
    """`[D, C]`: conjugate gradients from `start` `[D, C]`. Nothing is kept of the frames from one iteration to the next.

    Args:
        iterations: at most.
        settled: asked after each iteration, with the unknowns, whether it was the last.
        each: called after each frame of each pass.
    """
    x = start.clone()
    r = problem.gradient(x, each)
    z = problem.precondition(r)
    p, rz = z.clone(), dot(r, z)
    for _ in range(iterations):
        q = problem.normal(p, each)
        step = ratio(rz, dot(p, q)).float()
        x += step * p
        r -= step * q
        z = problem.precondition(r)
        old, rz = rz, dot(r, z)
        if settled(x) or bool((rz == 0).all()):
            break
        p = z + ratio(rz, old).float() * p
    return x


def dot(a: Tensor, b: Tensor) -> Tensor:
    """`[C]` in float64, without a float64 copy of the vectors."""
    return (a * b).sum(0, dtype=torch.float64)


def ratio(a: Tensor, b: Tensor) -> Tensor:
    """a / b, and 0 where b is: a problem that is solved stays as it is."""
    return torch.where(b > 0, a / b.clamp_min(torch.finfo(torch.float64).tiny), torch.zeros_like(a))
