"""The paper: normalised gradient fields on a pyramid (Eq. 7), ε = 1e-6, w_l = 0.5^l."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.config import PAPER_EPSILON, PAPER_LEVEL_WEIGHTS
from rtgs.experiments.rivals.losses import Rival
from rtgs.losses.ngf import NgfPyramid
from rtgs.losses.ngf_fused import FusedNgf


class Ngf:
    """Eq. 7 with these level weights and ε."""

    def __init__(
        self,
        thermal: NDArray[np.float32],
        mask: NDArray[np.bool_],
        level_weights: tuple[float, ...] = PAPER_LEVEL_WEIGHTS,
        epsilon: float | tuple[float, ...] = PAPER_EPSILON,
        render_epsilon: float | tuple[float, ...] | None = None,
    ) -> None:
        target = torch.from_numpy(thermal).to(torch.float64)
        valid = torch.from_numpy(np.ascontiguousarray(mask))
        pyramid = NgfPyramid.of(target, valid, level_weights=level_weights, epsilon=epsilon, render_epsilon=render_epsilon)
        self._fused = FusedNgf.of(pyramid)

    def __call__(self, gray: NDArray[np.float32], tangent: NDArray[np.float32]) -> tuple[float, float]:
        products = self._fused.products(gray, tangent[None])
        return products.loss, float(products.slope[0])


NGF_PYRAMID = Rival("ngf_pyramid", "NGF pyramid (the paper)", Ngf)
