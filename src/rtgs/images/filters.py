"""Pictures as tensors: grayscale, Sobel gradients, pyramids."""

from __future__ import annotations

import math

import torch
from torch import Tensor

# ITU-R BT.601 luma, the paper's "fixed grayscale conversion" g.
GRAY_WEIGHTS = (0.299, 0.587, 0.114)

# Weights (beside, in the middle) across a 3×3 derivative filter.
SOBEL = (1.0, 2.0)


def to_gray(rgb: Tensor) -> Tensor:
    """`[..., 3]` → `[...]`."""
    return rgb @ torch.tensor(GRAY_WEIGHTS, dtype=rgb.dtype)


def sobel(image: Tensor, across: tuple[float, float] = SOBEL) -> tuple[Tensor, Tensor]:
    """∂/∂x and ∂/∂y by the 3×3 Sobel filters of Eq. 5, unnormalised.

    Args:
        image: `[H, W]`.
        across: another smoothing across the derivative than Sobel's 1, 2, 1: (beside, in the middle).

    Returns:
        Two `[H − 2, W − 2]`: only pixels whose nine neighbours exist.
    """
    # Separable: smooth across, then difference along.
    beside, middle = across
    down = beside * (image[:-2] + image[2:]) + middle * image[1:-1]
    right = beside * (image[:, :-2] + image[:, 2:]) + middle * image[:, 1:-1]
    return down[:, 2:] - down[:, :-2], right[2:] - right[:-2]


def downsample(image: Tensor, factor: int) -> Tensor:
    """Mean over `factor` × `factor` blocks of `[H, W]` or `[H, W, C]`; rows and columns left over at the bottom and right are dropped."""
    if factor == 1:
        return image
    h, w = image.shape[0] // factor, image.shape[1] // factor
    blocks = image[: h * factor, : w * factor].reshape(h, factor, w, factor, *image.shape[2:])
    return blocks.mean(dim=(1, 3))


def blurred(images: Tensor, sigma: float) -> Tensor:
    """`[K, H, W]` convolved with a Gaussian of standard deviation `sigma` pixels; the border is continued by its own pixels."""
    reach = max(1, math.ceil(3.0 * sigma))
    x = torch.arange(-reach, reach + 1, dtype=images.dtype, device=images.device)
    kernel = torch.exp(-0.5 * (x / sigma) ** 2)
    kernel = kernel / kernel.sum()
    padded = torch.nn.functional.pad(images[:, None], (reach, reach, reach, reach), mode="replicate")
    return torch.nn.functional.conv2d(torch.nn.functional.conv2d(padded, kernel.view(1, 1, 1, -1)), kernel.view(1, 1, -1, 1))[
        :, 0
    ]


def downsample_mask(mask: Tensor, factor: int) -> Tensor:
    """A block of a bool mask `[H, W]` is valid when every pixel in it is."""
    h, w = mask.shape[0] // factor, mask.shape[1] // factor
    return mask[: h * factor, : w * factor].reshape(h, factor, w, factor).all(dim=3).all(dim=1)


def erode_for_sobel(mask: Tensor) -> Tensor:
    """`[H, W]` → `[H − 2, W − 2]`: pixels whose nine neighbours are all valid."""
    rows = mask[:-2] & mask[1:-1] & mask[2:]
    return rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:]
