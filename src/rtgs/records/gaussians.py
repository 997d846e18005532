"""A 3D Gaussian model: the tensors and what they mean."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.maths import sh
from rtgs.maths.geometry import quat_from_rotation


class Geometry(NamedTuple):
    """Where N Gaussians are and what they cover, without their colours; fields as in `Gaussians`."""

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    opacity_logits: Tensor


@dataclass(frozen=True, eq=False)
class Gaussians:
    """N Gaussians in the world frame. The name of a field says under which activation it is stored.

    Attributes:
        means: `[N, 3]`, SfM units.
        quats: `[N, 4]` `wxyz`, of any non-zero length.
        log_scales: `[N, 3]`, ln of the standard deviations along the principal axes.
        opacity_logits: `[N]`, opacity = sigmoid.
        sh: `[N, K, C]`, K = (degree + 1)² coefficients, C = 3 (RGB) or 1 (thermal); colour = max(0, ½ + basis · sh).
    """

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    opacity_logits: Tensor
    sh: Tensor

    def __len__(self) -> int:
        return self.means.shape[0]

    @property
    def geometry(self) -> Geometry:
        return Geometry(self.means, self.quats, self.log_scales, self.opacity_logits)

    @property
    def sh_degree(self) -> int:
        """The highest band of `sh`."""
        return int(self.sh.shape[1] ** 0.5 + 0.5) - 1

    @property
    def channels(self) -> int:
        """3 for RGB, 1 for thermal."""
        return self.sh.shape[2]

    def tensors(self) -> dict[str, Tensor]:
        """The fields by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def to(self, *args: Any, **kwargs: Any) -> Gaussians:
        """The same model with another type or on another device; takes what `Tensor.to` takes."""
        return Gaussians(**{k: v.to(*args, **kwargs) for k, v in self.tensors().items()})

    def detach(self) -> Gaussians:
        """The same values without their history of gradients."""
        return Gaussians(**{k: v.detach() for k, v in self.tensors().items()})

    def scaled(self, factor: float) -> Gaussians:
        """The same model in a unit `factor` times smaller (lengths × factor); opacities and colours stay."""
        return Gaussians(
            self.means * factor,
            self.quats,
            self.log_scales + torch.log(torch.tensor(factor, dtype=self.log_scales.dtype)),
            self.opacity_logits,
            self.sh,
        )

    def turned(self, rotation: NDArray[np.float64]) -> Gaussians:
        """The same model turned about the origin by `rotation` `[3, 3]`, its harmonics with it."""
        dtype = self.means.dtype
        turn = torch.as_tensor(rotation, dtype=torch.float64)
        w, x, y, z = (float(v) for v in quat_from_rotation(rotation))
        left = torch.tensor([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]], dtype=torch.float64)
        return Gaussians(
            (self.means.double() @ turn.T).to(dtype),
            (self.quats.double() @ left.T).to(dtype),
            self.log_scales,
            self.opacity_logits,
            torch.einsum("jk,nkc->njc", sh.turning(rotation, self.sh_degree), self.sh.double()).to(dtype),
        )
