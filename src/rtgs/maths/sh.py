"""Real spherical harmonics of degree 0–3 in 3DGS's order and sign."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

# The usual normalisation constants; the signs follow the 3DGS reference, so that its PLY files mean the same here.
C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


def coefficients(degree: int) -> int:
    """K = (degree + 1)²."""
    return (degree + 1) ** 2


def turning(rotation: NDArray[np.float64], degree: int) -> Tensor:
    """`[K, K]` float64: takes coefficients of a model to those of the same model turned by `rotation` `[3, 3]`.

    The turned model shows in the direction `rotation @ d` what the model shows in `d`. Each band is closed under rotations, so the
    coefficients that agree in enough directions agree in all.
    """
    generator = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(
        torch.randn(4 * coefficients(degree), 3, generator=generator, dtype=torch.float64), dim=1
    )
    before = directions @ torch.as_tensor(rotation, dtype=torch.float64)
    return torch.linalg.lstsq(basis(directions, degree), basis(before, degree)).solution


def basis(directions: Tensor, degree: int) -> Tensor:
    """Evaluate the basis.

    Args:
        directions: `[..., 3]`, of unit length.
        degree: 0–3.

    Returns:
        `[..., K]`.
    """
    x, y, z = directions.unbind(-1)
    terms = [torch.full_like(x, C0)]
    if degree >= 1:
        terms += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        terms += [C2[0] * x * y, C2[1] * y * z, C2[2] * (2 * zz - xx - yy), C2[3] * x * z, C2[4] * (xx - yy)]
    if degree >= 3:
        terms += [
            C3[0] * y * (3 * xx - yy),
            C3[1] * x * y * z,
            C3[2] * y * (4 * zz - xx - yy),
            C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            C3[4] * x * (4 * zz - xx - yy),
            C3[5] * z * (xx - yy),
            C3[6] * x * (xx - 3 * yy),
        ]
    return torch.stack(terms, dim=-1)
