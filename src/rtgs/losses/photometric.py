"""The training loss of a rendered view, ℓ1 + w (1 − SSIM), value and gradient in three compiled passes.

The passes also compose the image from the render, and take the gradients back through that:

    image = gain · (color + (1 − alpha) · background) + offset
    loss  = mean |image − target| + w (1 − SSIM(image, target))

`reference_photometric` is the specification in plain torch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import prange
from torch import Tensor

from rtgs.base.compiled import kernel
from rtgs.losses.ssim import reference_ssim, ssim_and_gradient

_SSIM_STRIDE = 2  # window rows from one that counts to the next


class Appearance(NamedTuple):
    """How a photograph comes from a render: background, and the camera's gain and offset, `[3]` each."""

    background: Tensor
    gain: Tensor
    offset: Tensor


@dataclass(frozen=True, eq=False)
class Target:
    """A photograph, and what of it counts.

    Attributes:
        image: `[H, W, 3]`.
        pixels: `[H, W]` bool, the pixels of ℓ1; all when None.
        windows: `[H, W]` bool, the centres of SSIM's windows; all inside the image when None.
    """

    image: Tensor
    pixels: Tensor | None = None
    windows: Tensor | None = None


def photometric(
    color: Tensor, alpha: Tensor, appearance: Appearance, target: Target, *, ssim_weight: float, parity: int = 0
) -> Tensor:
    """The loss, a scalar, differentiable in all but the target. float32 on the CPU.

    SSIM is taken over every second row of windows, whose mean differs by 1 % of its gradient from that of all rows. Alternate `parity`
    between steps to cover all rows.

    Args:
        color: `[H, W, 3]`, premultiplied, as `Render` has it.
        alpha: `[H, W]`.
        parity: 0 or 1, which rows of windows.

    Raises:
        ValueError: the image is smaller than SSIM's window.
    """
    result: Tensor = _Photometric.apply(target, ssim_weight, parity, color, alpha, *appearance)
    return result


def reference_photometric(color: Tensor, alpha: Tensor, appearance: Appearance, target: Target, *, ssim_weight: float) -> Tensor:
    """The same over all rows of windows, in plain torch, any dtype."""
    background, gain, offset = appearance
    image = gain * (color + (1.0 - alpha)[..., None] * background) + offset
    difference = (image - target.image).abs()
    l1 = difference.mean() if target.pixels is None else difference[target.pixels].mean()
    return l1 + ssim_weight * (1.0 - reference_ssim(image, target.image, target.windows))


class _Photometric(torch.autograd.Function):
    """Inputs: target, weight of SSIM, parity, then colour, alpha and the three tensors of the appearance."""

    @staticmethod
    def forward(ctx: Any, target: Target, ssim_weight: float, parity: int, *tensors: Tensor) -> Tensor:
        c, a, b, k, o = (x.detach().contiguous().numpy() for x in tensors)
        t = target.image.detach().contiguous().numpy()
        valid = np.zeros((0, 0), np.bool_) if target.pixels is None else target.pixels.numpy()
        image = np.empty_like(c)
        _compose(c, a, b, k, o, image)
        value = 0.0
        if ssim_weight != 0.0:
            centres = None if target.windows is None else target.windows.numpy()
            similarity, gradient = ssim_and_gradient(image, t, centres, first=parity, stride=_SSIM_STRIDE)
            value = ssim_weight * (1.0 - similarity)
        else:
            gradient = np.zeros_like(image)
        l1_weight = np.float32(1.0 / (3 * (valid.sum() if valid.size else a.size)))
        g_alpha, sums = np.empty_like(a), np.empty((-(-len(a) // _BAND), 10))
        b_row, k_row = np.tile(b, a.shape[1]), np.tile(k, a.shape[1])
        _decompose(c, a, b_row, k_row, image, t, valid, l1_weight, np.float32(-ssim_weight), gradient, g_alpha, sums)
        total = sums.sum(axis=0)
        ctx.gradients = [torch.from_numpy(g) for g in (gradient, g_alpha, *np.split(total[1:].astype(np.float32), 3))]
        return tensors[0].new_tensor(total[0] + value)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, ...]:
        scale = grad_outputs[0]
        # As a rule nothing comes after the loss, and this saves a pass over the image.
        gradients = ctx.gradients if scale.item() == 1.0 else [g * scale for g in ctx.gradients]
        return (None, None, None, *gradients)


_BAND = 16  # rows a thread takes at a time


@kernel("fast", parallel=True)
def _compose(color, alpha, background, gain, offset, image):  # type: ignore[no-untyped-def]
    b0, b1, b2 = background[0] * gain[0], background[1] * gain[1], background[2] * gain[2]
    k0, k1, k2 = gain[0], gain[1], gain[2]
    o0, o1, o2 = offset[0], offset[1], offset[2]
    for y in prange(color.shape[0]):
        for x in range(color.shape[1]):
            through = np.float32(1.0) - alpha[y, x]
            image[y, x, 0] = k0 * color[y, x, 0] + b0 * through + o0
            image[y, x, 1] = k1 * color[y, x, 1] + b1 * through + o1
            image[y, x, 2] = k2 * color[y, x, 2] + b2 * through + o2


@kernel("fast", parallel=True)
def _decompose(  # type: ignore[no-untyped-def]
    color, alpha, background, gain, image, target, valid, l1_weight, ssim_factor, gradient, g_alpha, sums
):
    """`gradient` comes in as ∂SSIM/∂image and leaves as ∂loss/∂color. `background` and `gain` are `[3·W]`, repeated.

    `sums` `[bands, 10]` = ℓ1 | background | gain | offset.
    """
    height, width = alpha.shape
    for band in prange(len(sums)):
        # Rows of 3·W floats, with what is said by pixel written out: then every sum is a vector.
        through, counts = np.empty(3 * width, np.float32), np.full(3 * width, l1_weight)
        parts = np.zeros((3, 3 * width), np.float32)
        to_background, to_gain, to_offset = parts[0], parts[1], parts[2]
        l1 = np.float32(0.0)
        for y in range(band * _BAND, min(height, (band + 1) * _BAND)):
            for x in range(width):
                t = np.float32(1.0) - alpha[y, x]
                through[3 * x], through[3 * x + 1], through[3 * x + 2] = t, t, t
            if valid.size > 0:
                for x in range(width):
                    weight = l1_weight if valid[y, x] else np.float32(0.0)
                    counts[3 * x], counts[3 * x + 1], counts[3 * x + 2] = weight, weight, weight
            own, shown, wanted, g = color[y].ravel(), image[y].ravel(), target[y].ravel(), gradient[y].ravel()
            for i in range(3 * width):
                difference = shown[i] - wanted[i]
                l1 += counts[i] * abs(difference)
                slope = ssim_factor * g[i] + (counts[i] if difference > np.float32(0.0) else -counts[i])
                to_offset[i] += slope
                to_gain[i] += slope * (own[i] + through[i] * background[i])
                to_background[i] += slope * gain[i] * through[i]
                g[i] = slope * gain[i]
            b0, b1, b2 = background[0], background[1], background[2]
            for x in range(width):
                g_alpha[y, x] = -(g[3 * x] * b0 + g[3 * x + 1] * b1 + g[3 * x + 2] * b2)
        sums[band, 0] = l1
        for k in range(3):
            for c in range(3):
                total = 0.0
                for x in range(width):
                    total += parts[k, 3 * x + c]
                sums[band, 1 + 3 * k + c] = total
