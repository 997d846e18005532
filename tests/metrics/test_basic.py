"""Known answers and laws of the image metrics."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torchmetrics.functional.image import peak_signal_noise_ratio, structural_similarity_index_measure

from rtgs.metrics.basic import mae, psnr, ssim_index

RNG = np.random.default_rng(0)
A = RNG.random((24, 30, 3)).astype(np.float32)
B = np.clip(A + 0.1 * RNG.standard_normal(A.shape), 0, 1).astype(np.float32)
LEFT = np.zeros((24, 30), dtype=bool)
LEFT[:, :16] = True


def test_psnr_of_a_known_difference() -> None:
    assert psnr(np.full((4, 5), 0.6), np.full((4, 5), 0.5)) == pytest.approx(20.0)
    assert psnr(A, A) == math.inf
    assert psnr(A, B) == pytest.approx(peak_signal_noise_ratio(torch.tensor(A), torch.tensor(B), data_range=1.0).item(), abs=1e-4)


def test_mae_keeps_the_unit() -> None:
    assert mae(np.array([[20.0, 30.0]]), np.array([[21.0, 28.0]])) == pytest.approx(1.5)
    assert mae(np.zeros((2, 2), np.uint8), np.ones((2, 2), np.uint8)) == pytest.approx(1.0)  # unsigned must not wrap round


def test_ssim_laws() -> None:
    assert ssim_index(A, A) == pytest.approx(1.0)
    assert ssim_index(A, B) == pytest.approx(ssim_index(B, A))
    assert ssim_index(A, B) < 0.999
    assert ssim_index(A[..., 0], B[..., 0]) == pytest.approx(ssim_index(A[..., :1], B[..., :1]))
    p, q = 0.2, 0.7  # constant images: the luminance term alone
    assert ssim_index(np.full((20, 20), p), np.full((20, 20), q)) == pytest.approx((2 * p * q + 1e-4) / (p * p + q * q + 1e-4))


@pytest.mark.parametrize("channels", [1, 3])
def test_ssim_is_torchmetrics(channels: int) -> None:
    a, b = (torch.from_numpy(image[..., :channels].astype(np.float64).transpose(2, 0, 1))[None] for image in (A, B))
    _, values = structural_similarity_index_measure(a, b, sigma=1.5, data_range=1.0, return_full_image=True)
    assert ssim_index(A[..., :channels], B[..., :channels]) == pytest.approx(float(values.mean()), abs=1e-12)


@pytest.mark.parametrize("metric", [psnr, mae, ssim_index])
def test_a_mask_shuts_out_everything_else(metric: Callable[..., float]) -> None:
    spoiled = B.copy()
    spoiled[~LEFT] = np.nan
    assert metric(spoiled, A, mask=LEFT) == pytest.approx(metric(B, A, mask=LEFT))
    assert metric(B, A, mask=np.ones((24, 30), dtype=bool)) == pytest.approx(metric(B, A))
    assert metric(B, A, mask=LEFT) != pytest.approx(metric(B, A), abs=1e-9)


@pytest.mark.parametrize("metric", [psnr, mae, ssim_index])
def test_nonsense_is_refused(metric: Callable[..., float]) -> None:
    with pytest.raises(ValueError, match="one shape"):
        metric(A, A[:-1])
    with pytest.raises(ValueError, match="mask is"):
        metric(A, B, mask=np.ones((24, 30)))
    with pytest.raises(ValueError, match="no pixel"):
        metric(A, B, mask=np.zeros((24, 30), dtype=bool))
    with pytest.raises(ValueError, match="NaN"):
        metric(np.full_like(A, np.nan), B)


def test_ssim_needs_room_for_a_window() -> None:
    with pytest.raises(ValueError, match="at least 11"):
        ssim_index(np.zeros((10, 30)), np.zeros((10, 30)))
    with pytest.raises(ValueError, match="no 11"):
        narrow = np.zeros((24, 30), dtype=bool)
        narrow[:, 10:15] = True
        ssim_index(A, B, mask=narrow)
