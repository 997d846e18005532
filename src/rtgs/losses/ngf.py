"""The Normalized Gradient Field loss of the paper (Eqs. 5–7).

After Haber and Modersitzki (2006): two images agree where their gradients are parallel *or* anti-parallel, so a contrast that inverts
between the modalities costs nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from rtgs.config import PAPER_EPSILON
from rtgs.images.filters import SOBEL, downsample, downsample_mask, erode_for_sobel, sobel
from rtgs.losses.edge_loss import EdgeLoss, Products

PAPER_LOSS = EdgeLoss()
LEAST_STRENGTH = 1e-6
"""Least strength of a render's edges that the loss per edge divides by. So a render without edges costs 1, as in Eq. 6."""


def normalized_gradient(image: Tensor, epsilon: float = PAPER_EPSILON, across: tuple[float, float] = SOBEL) -> Tensor:
    """Eq. 5: ∇I / √(‖∇I‖² + ε²) of `[H, W]`, as `[2, H − 2, W − 2]`; `across` as in `rtgs.images.filters.sobel`."""
    gx, gy = sobel(image, across)
    # hypot-free: ε² underflows float32 only below 1e-19, far under any ε in use.
    inverse = torch.rsqrt(gx * gx + gy * gy + epsilon * epsilon)
    return torch.stack([gx * inverse, gy * inverse])


def ngf_loss(a: Tensor, b: Tensor, *, epsilon: float = PAPER_EPSILON, mask: Tensor | None = None) -> Tensor:
    """Eq. 6: mean of 1 − (n_A · n_B)² over the pixels that have a Sobel gradient.

    Args:
        a, b: `[H, W]`.
        mask: `[H, W]` bool; a pixel counts when its whole 3×3 neighbourhood is valid.

    Returns:
        A scalar in [0, 1]: 0 where every gradient is parallel or anti-parallel, exactly 1 when either image is featureless.
    """
    target = _Level.of(b, epsilon, torch.ones_like(b, dtype=torch.bool) if mask is None else mask)
    return target.loss(normalized_gradient(a, epsilon), per_edge=False)


@dataclass(frozen=True, eq=False)
class _Level:
    gradient: Tensor  # [2, h, w], zero outside the mask
    valid: Tensor  # [h, w] bool
    pixels: int

    @staticmethod
    def of(image: Tensor, epsilon: float, mask: Tensor, across: tuple[float, float] = SOBEL) -> _Level:
        valid = erode_for_sobel(mask)
        gradient = normalized_gradient(image, epsilon, across)
        return _Level(torch.where(valid, gradient, torch.zeros_like(gradient)), valid, int(valid.sum()))  # not a product: NaN · 0

    def loss(self, gradient: Tensor, per_edge: bool) -> Tensor:
        # A pixel outside the mask contributes 0 to the sum and is not counted.
        dot = (gradient * self.gradient).sum(0)
        agreement = dot.square().sum() / max(self.pixels, 1)
        return 1.0 - (agreement / self.strength(gradient) if per_edge else agreement)

    def strength(self, gradient: Tensor) -> Tensor:
        """Root mean square of ‖n_A‖ over the valid pixels."""
        square = gradient.square().sum(0)[self.valid].sum()
        return (square / max(self.pixels, 1)).clamp_min(LEAST_STRENGTH**2).sqrt()


@dataclass(frozen=True, eq=False)
class NgfPyramid:
    """Eq. 7 against one fixed image, whose gradients are computed once, in PyTorch: the specification.

    Build it with `NgfPyramid.of`. Called with a render `[H, W]` it gives the loss as a tensor, which autograd can differentiate.
    """

    levels: tuple[_Level, ...]
    settings: EdgeLoss

    @staticmethod
    def of(image: Tensor, mask: Tensor | None = None, settings: EdgeLoss = PAPER_LOSS) -> NgfPyramid:
        """Prepare the target.

        Args:
            image: `[H, W]`.
            mask: `[H, W]` bool, pixels where the loss counts; None: all. It belongs to the image, so it does not follow the scale.
        """
        if mask is None:
            mask = torch.ones_like(image, dtype=torch.bool)
        levels = tuple(
            _Level.of(downsample(image, 2**l), epsilon, downsample_mask(mask, 2**l), settings.across)
            for l, epsilon in zip(range(len(settings.level_weights)), settings.epsilons, strict=True)
        )
        return NgfPyramid(levels, settings)

    def to(self, dtype: torch.dtype) -> NgfPyramid:
        """The same target in another floating type."""
        levels = tuple(replace(level, gradient=level.gradient.to(dtype)) for level in self.levels)
        return replace(self, levels=levels)

    def __call__(self, render: Tensor) -> Tensor:
        """Σ_l w_l ℓ_NGF(D_l A, D_l B) / Σ_l w_l for a render A `[H, W]`."""
        total = torch.zeros((), dtype=render.dtype)
        for l, level in enumerate(self.levels):
            total = total + self.settings.level_weights[l] * level.loss(self._gradient(render, l), self.settings.per_edge)
        return total / sum(self.settings.level_weights)

    def loss(self, picture: Tensor) -> float:
        """Eq. 7 of a picture `[H, W]`, as a number."""
        return float(self(picture))

    def products(self, picture: Tensor, tangents: Tensor, *, curvature: bool = True) -> Products:
        """Eq. 7 of a picture `[H, W]` and its slopes along tangents `[K, H, W]`, with the Gauss–Newton matrix of `residuals`."""
        losses, slopes, changes = [], [], []
        none = picture.new_zeros(1)
        for tangent in tangents:
            loss, slope = torch.func.jvp(self, (picture,), (tangent,))  # type: ignore[misc]
            change = torch.func.jvp(self.residuals, (picture,), (tangent,))[1] if curvature else none
            losses.append(loss)
            slopes.append(float(slope))
            changes.append(change)
        jacobian = torch.stack(changes)
        return Products(float(losses[0]), np.array(slopes), (2.0 * jacobian @ jacobian.T).numpy().astype(np.float64))

    def residuals(self, render: Tensor) -> Tensor:
        """`[M]`: the vector whose squared norm is Eq. 7; what Gauss–Newton works on.

        There are two numbers a pixel and level, n_A × n_B and √(1 − ‖n_A‖²‖n_B‖²). Their squares sum to 1 − (n_A · n_B)² (Lagrange's
        identity). The cross product alone would be zero for a blank render. Per edge, the residuals of a level are divided by the root
        of its rms ‖n_A‖, which counts as constant. Their squared norm is then no longer the loss, but their Gauss–Newton matrix is
        still its curvature where the edges stay what they are.
        """
        parts = []
        for l, level in enumerate(self.levels):
            n, m = self._gradient(render, l), level.gradient
            share = math.sqrt(self.settings.level_weights[l] / sum(self.settings.level_weights) / max(level.pixels, 1))
            scale = level.strength(n).detach().rsqrt() if self.settings.per_edge else 1.0
            if not level.pixels:  # costs 1 whatever the render
                parts.append(torch.full((1,), share, dtype=render.dtype))
                continue
            cross = (n[0] * m[1] - n[1] * m[0])[level.valid]
            rest = (1.0 - n.square().sum(0) * m.square().sum(0))[level.valid].clamp_min(0.0)
            parts += [share * scale * cross, share * scale * rest.sqrt()]
        return torch.cat(parts)

    def _gradient(self, render: Tensor, level: int) -> Tensor:
        return normalized_gradient(downsample(render, 2**level), self.settings.render_epsilons[level], self.settings.across)
