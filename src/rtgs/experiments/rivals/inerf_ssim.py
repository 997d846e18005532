"""iNeRF (Yen-Chen et al. 2021) with structural similarity: local means, variances and covariance have to agree."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.experiments.rivals.losses import Rival
from rtgs.losses.ssim import ssim_and_gradient, whole_windows


class Ssim:
    """1 − SSIM over the windows that see valid pixels only."""

    def __init__(self, thermal: NDArray[np.float32], mask: NDArray[np.bool_]) -> None:
        self._thermal = np.ascontiguousarray(thermal, dtype=np.float32)[..., None]
        self._windows = None if mask.all() else whole_windows(torch.from_numpy(mask)).numpy()

    def __call__(self, gray: NDArray[np.float32], tangent: NDArray[np.float32]) -> tuple[float, float]:
        value, gradient = ssim_and_gradient(np.ascontiguousarray(gray)[..., None], self._thermal, self._windows)
        return 1.0 - value, -float(np.vdot(gradient[..., 0], tangent))


INERF_SSIM = Rival("inerf_ssim", "iNeRF (SSIM)", Ssim, smooth_px=2.0)
