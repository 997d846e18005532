"""Smooth random pictures for tests of losses."""

from __future__ import annotations

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor


def textured(height: int = 45, width: int = 58, seed: int = 0) -> Tensor:
    """`[H, W]` float64 in [0, 1], smoothed noise: a gradient everywhere, of every direction."""
    smooth = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(height, width)), 1.5)
    return torch.from_numpy((smooth - smooth.min()) / np.ptp(smooth))


def ramp(height: int, width: int, direction: tuple[float, float]) -> Tensor:
    """`[H, W]` float64 with the same gradient everywhere."""
    y, x = torch.meshgrid(torch.arange(height).double(), torch.arange(width).double(), indexing="ij")
    return (direction[0] * x + direction[1] * y) / 50.0


def holes(height: int = 45, width: int = 58) -> Tensor:
    """`[H, W]` bool: a mask with a rectangle and the last row left out."""
    mask = torch.ones(height, width, dtype=torch.bool)
    mask[5:9, 7:20] = False
    mask[-1] = False
    return mask
