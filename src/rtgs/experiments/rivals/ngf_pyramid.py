"""The paper: normalised gradient fields on a pyramid (Eq. 7), ε = 1e-6, w_l = 0.5^l."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.experiments.rivals.losses import Rival
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.losses.ngf import PAPER_LOSS, NgfPyramid
from rtgs.losses.ngf_fused import FusedNgf


class Ngf:
    """Eq. 7 against one thermal image, as a loss of a gray picture and its tangent."""

    def __init__(
        self,
        thermal: NDArray[np.float32],
        mask: NDArray[np.bool_],
        edge_loss: EdgeLoss = PAPER_LOSS,
    ) -> None:
        target = torch.from_numpy(thermal).to(torch.float64)
        valid = torch.from_numpy(np.ascontiguousarray(mask))
        self._fused = FusedNgf.of(NgfPyramid.of(target, valid, edge_loss))

    def __call__(self, gray: NDArray[np.float32], tangent: NDArray[np.float32]) -> tuple[float, float]:
        products = self._fused.products(torch.from_numpy(gray), torch.from_numpy(tangent)[None])
        return products.loss, float(products.slope[0])


NGF_PYRAMID = Rival("ngf_pyramid", "NGF pyramid (the paper)", Ngf)
