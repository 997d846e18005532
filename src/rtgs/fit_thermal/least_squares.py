"""Weighted least squares with a ridge, by preconditioned conjugate gradients on the normal equations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from rtgs.fit_thermal.design import Design


@dataclass(frozen=True, eq=False)
class Problem:
    """Least x of Σ_f ‖image_f − design_f · x − offset_f‖² + Σ ridge · (x − prior)², each pixel weighed, C times side by side.

    Offsets, where a problem has any, are eliminated exactly: the weighted mean is taken out of every residual. So is a surface that all
    frames have in common.

    Attributes:
        frames: indices of those that count.
        images, weights: `[h, w, 1 or C]` and `[h, w]`, of all frames of the design.
        offsets: `[C]`, 1 for a problem in which each frame has an offset of its own, 0 where they are 0; None: 0 everywhere.
        surface: `[h, w, B]`, of which all frames may have any one combination added; None: none.
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

    def gradient(
        self, x: Tensor, each: Callable[[], None] = lambda: None, shown: Sequence[Tensor] | None = None
    ) -> tuple[Tensor, Tensor]:
        """Half the direction of descent `[D, C]`, and the value of the sum `[C]` in float64.

        Args:
            shown: `design.image` of `x` by frame, where it is known already.
        """
        away = x - self.prior
        out, value = -self.ridge * away, (self.ridge * away**2).sum(0, dtype=torch.float64)
        residuals = (self.images[f] - (self.design.image(f, x) if shown is None else shown[f]) for f in self.frames)

        def add(residual: Tensor, weighted: Tensor) -> None:
            value.add_((residual * weighted).sum((0, 1), dtype=torch.float64))

        value -= self._add_transpose(residuals, out, each, add)
        return out, value

    def normal(self, p: Tensor, each: Callable[[], None] = lambda: None, images: list[Tensor] | None = None) -> Tensor:
        """(designᵀ · weights · design + ridge) · p; design · p, frame by frame, is appended to `images`."""
        out = self.ridge * p
        drawn = (self.design.image(f, p) for f in self.frames)
        self._add_transpose(drawn, out, each, lambda image, _: None if images is None else images.append(image))
        return out

    def precondition(self, r: Tensor) -> Tensor:
        z = r / self.background
        self.design.harmonics(z).copy_(torch.bmm(self.inverses, self.design.harmonics(r)))
        return z

    def _add_transpose(
        self, images: Iterable[Tensor], out: Tensor, each: Callable[[], None], seen: Callable[[Tensor, Tensor], None]
    ) -> Tensor:
        """out += designᵀ · weights · (images less what offsets and surface would make of them).

        Args:
            seen: is shown each frame's image, and weights · (image less its offset).

        Returns:
            `[C]`, float64: what the surface takes from Σ image · weights · (image less its offset).
        """
        kept: list[Tensor] = []  # the surface is known when all frames have been seen
        for f, image in zip(self.frames, images, strict=True):
            weighted = self._weighted(f, image)
            seen(image, weighted)
            if self.surface is None:
                self.design.add_transpose(f, weighted, out)
                each()
            else:
                kept.append(weighted)
        if self.surface is None:
            return torch.zeros(out.shape[1], dtype=torch.float64)
        planes = self.surface.permute(2, 0, 1).flatten(1)
        right = sum((planes @ w.flatten(0, 1) for w in kept), torch.zeros(len(planes), out.shape[1]))
        amounts = torch.einsum("cbd,dc->bc", self._surface_inverses, right)
        if self.surfaces is not None:
            amounts = amounts * self.surfaces
        common = self.surface @ amounts
        subtracted: dict[int, Tensor] = {}  # by weights: most often all frames have the same
        for f, weighted in zip(self.frames, kept, strict=True):
            key = id(self.weights[f])
            if key not in subtracted:
                subtracted = {key: self._weighted(f, common)}
            self.design.add_transpose(f, weighted.sub_(subtracted[key]), out)
            each()
        return (right * amounts).sum(0, dtype=torch.float64)

    @cached_property
    def _surface_inverses(self) -> Tensor:
        """`[C, B, B]`: inverse of the normal matrix of the surface alone, without or with offsets besides."""
        assert self.surface is not None
        surface = self.surface

        def inverse(offset: float) -> Tensor:
            alone = replace(self, offsets=torch.tensor([offset]))
            products: dict[int, Tensor] = {}  # by weights: most often all frames have the same
            for f in self.frames:
                if id(self.weights[f]) not in products:
                    products[id(self.weights[f])] = torch.einsum("hwb,hwc->bc", surface, alone._weighted(f, surface))
            normal = torch.stack([products[id(self.weights[f])] for f in self.frames]).sum(0)
            return torch.linalg.pinv(normal, hermitian=True)

        offsets = [0.0] * self.ridge.shape[1] if self.offsets is None else self.offsets.tolist()
        inverses = {offset: inverse(offset) for offset in set(offsets)}
        return torch.stack([inverses[offset] for offset in offsets])

    def _weighted(self, frame: int, image: Tensor) -> Tensor:
        """Weights · (image less its weighted mean, where there are offsets)."""
        weights = self.weights[frame]
        weighted = image * weights[..., None]
        if self.offsets is not None:
            means = weighted.sum((0, 1)) / weights.sum().clamp_min(1e-12)
            weighted.addcmul_(weights[..., None], self.offsets * means, value=-1.0)
        return weighted


def preconditioner(blocks: Tensor, background: float, ridge: Tensor, design: Design) -> tuple[Tensor, float]:
    """`Problem.inverses` `[N, K, K]` and `Problem.background`.

    A Gaussian's block is Σ_views (Σ_pixels weight) · basis ⊗ basis: the *sum* of what it contributes to pixels, not of its square.
    A pixel's weights add up to one, so column sums bound WᵀW from above (as SIRT has it in tomography); squares alone would tell each of
    the Gaussians that share a pixel to explain all of its residual.

    Args:
        blocks: `[N, K, K]`. background: likewise, a number. ridge: `[D]`.
    """
    return torch.linalg.inv(blocks + torch.diag_embed(design.harmonics(ridge))), background + float(ridge[-1])


@dataclass(frozen=True, eq=False)
class Solution:
    """`x` `[D, C]`; `iterations`; `residual` `[C]`: norm of the gradient that is left, relative to that at the start; `shown`:
    design · x of each of the problem's frames, where it was known of the start."""

    x: Tensor
    iterations: int
    residual: Tensor
    shown: list[Tensor] | None


def solve(
    problem: Problem,
    start: Tensor,
    *,
    iterations: int,
    tolerance: float = 0.0,
    settled: Callable[[Tensor], bool] = lambda x: False,
    shown: Sequence[Tensor] | None = None,
    each: Callable[[], None] = lambda: None,
) -> Solution:
    """Conjugate gradients from `start` `[D, C]`.

    Args:
        iterations: at most.
        tolerance: stop when an iteration lowered no problem's sum by more than this share of it.
        settled: asked after each iteration, with the unknowns, whether it was the last.
        shown: see `Problem.gradient`; kept up to date from iteration to iteration, which saves the next problem a pass.
        each: called after each frame of each pass.
    """
    x, done = start.clone(), 0
    images = None if shown is None else [shown[f] for f in problem.frames]
    r, value = problem.gradient(x, each, shown)
    z = problem.precondition(r)
    p, rz = z.clone(), _dot(r, z)
    first = rz
    while done < iterations:
        moves: list[Tensor] | None = None if images is None else []
        q = problem.normal(p, each, moves)
        step = _ratio(rz, _dot(p, q))
        if images is not None and moves is not None:
            images = [image + step.float() * move for image, move in zip(images, moves, strict=True)]
        x += step.float() * p
        r -= step.float() * q
        z = problem.precondition(r)
        gain, old, rz = step * rz, rz, _dot(r, z)
        value, done = value - gain, done + 1
        if settled(x) or bool((gain <= tolerance * value.clamp_min(0.0)).all()):
            break
        p = z + _ratio(rz, old).float() * p
    return Solution(x, done, _ratio(rz, first).sqrt(), images)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    """`[C]` in float64, without a float64 copy of the vectors."""
    return (a * b).sum(0, dtype=torch.float64)


def _ratio(a: Tensor, b: Tensor) -> Tensor:
    """a / b, and 0 where b is: a problem that is solved stays as it is."""
    return torch.where(b > 0, a / b.clamp_min(torch.finfo(torch.float64).tiny), torch.zeros_like(a))
