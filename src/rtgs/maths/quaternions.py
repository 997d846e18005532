"""Rotations of many Gaussians at once, in PyTorch. `rtgs.maths.geometry` has those of one pose, in NumPy."""

from __future__ import annotations

import torch
from torch import Tensor


def rotations_from_quats(quats: Tensor) -> Tensor:
    """`[N, 3, 3]` from quaternions wxyz `[N, 4]` of any non-zero length; differentiable, any dtype."""
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    return torch.stack(
        [
            1 - 2 * (y * y + z * z),
            2 * (x * y - w * z),
            2 * (x * z + w * y),
            2 * (x * y + w * z),
            1 - 2 * (x * x + z * z),
            2 * (y * z - w * x),
            2 * (x * z - w * y),
            2 * (y * z + w * x),
            1 - 2 * (x * x + y * y),
        ],
        dim=-1,
    ).reshape(-1, 3, 3)
