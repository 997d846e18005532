"""iNeRF (Yen-Chen et al. 2021) with ℓ1: the gray render is compared with the thermal image as if both were photographs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtgs.experiments.rivals.losses import Rival


class L1:
    """Mean |gray − thermal| over the valid pixels."""

    def __init__(self, thermal: NDArray[np.float32], mask: NDArray[np.bool_]) -> None:
        self._thermal = thermal
        self._weights = (mask / max(int(mask.sum()), 1)).astype(np.float32)

    def __call__(self, gray: NDArray[np.float32], tangent: NDArray[np.float32]) -> tuple[float, float]:
        difference = gray - self._thermal
        slope = np.vdot(np.sign(difference) * self._weights, tangent)
        return float(np.vdot(np.abs(difference, out=difference), self._weights)), float(slope)


INERF_L1 = Rival("inerf_l1", "iNeRF (ℓ1)", L1, smooth_px=2.0)
