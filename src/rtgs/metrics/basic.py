"""How close a render is to its reference: PSNR, SSIM, mean absolute error. NumPy in, one number out.

Every function takes `render` and `reference` as `[H, W]` or `[H, W, C]` of one shape, any float or integer type (computed in
float64), and `mask`, `[H, W]` bool: only its true pixels count. They raise ValueError when shapes differ or nothing is left to
count, and when a counted value is not finite: a NaN render must not pass for a score.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

SSIM_RADIUS_PX = 5  # the Gaussian window of Wang et al. is 11 × 11
_SSIM_SIGMA_PX = 1.5
_SSIM_C1, _SSIM_C2 = 0.01**2, 0.03**2


def psnr(render: ArrayLike, reference: ArrayLike, *, mask: NDArray[np.bool_] | None = None) -> float:
    """Peak signal-to-noise ratio, −10 log₁₀(MSE), in dB, of images in [0, 1]; infinite for equal images."""
    a, b, inside = checked(render, reference, mask)
    mse = float(np.mean((a - b)[inside] ** 2))
    return float("inf") if mse == 0 else 10.0 * float(np.log10(1.0 / mse))


def mae(render: ArrayLike, reference: ArrayLike, *, mask: NDArray[np.bool_] | None = None) -> float:
    """Mean absolute error, in the images' own unit (°C for temperatures)."""
    a, b, inside = checked(render, reference, mask)
    return float(np.mean(np.abs(a - b)[inside]))


def ssim_index(render: ArrayLike, reference: ArrayLike, *, mask: NDArray[np.bool_] | None = None) -> float:
    """Mean structural similarity (Wang et al. 2004) of images in [0, 1].

    Gaussian window of 11 × 11 pixels, σ = 1.5, borders reflected.

    With a mask, the mean of the SSIM map over the pixels whose window inside the image sees only true pixels: values outside the
    mask change nothing. An all-true mask gives the same as none.

    Raises:
        ValueError: also when a side is under 11 px, or no window fits into the mask.
    """
    a, b, inside = checked(render, reference, mask)
    if min(inside.shape) <= 2 * SSIM_RADIUS_PX:
        raise ValueError(f"SSIM needs at least {2 * SSIM_RADIUS_PX + 1} px a side; got {a.shape}")
    a, b = (np.where(inside[..., None], image, 0.0) for image in (a, b))  # a NaN outside the mask must not spread
    side = 2 * SSIM_RADIUS_PX + 1
    reached = cv2.dilate(
        (~inside).astype(np.uint8), np.ones((side, side), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    whole = reached == 0
    if not whole.any():
        raise ValueError("SSIM: no 11 × 11 window fits into the mask")
    return float(np.mean([_similarity(a[..., c], b[..., c])[whole] for c in range(a.shape[2])]))


def _similarity(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """The SSIM map of one channel, `[H, W]`. The window is applied along rows and columns in turn, which takes little memory."""
    offsets = np.arange(-SSIM_RADIUS_PX, SSIM_RADIUS_PX + 1)
    weights = np.exp(-0.5 * (offsets / _SSIM_SIGMA_PX) ** 2)
    weights /= weights.sum()

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(cv2.sepFilter2D(values, cv2.CV_64F, weights, weights, borderType=cv2.BORDER_REFLECT_101))

    a, b = np.ascontiguousarray(a), np.ascontiguousarray(b)
    mean_a, mean_b = mean(a), mean(b)
    variances = np.maximum(mean(a * a) - mean_a**2, 0.0) + np.maximum(mean(b * b) - mean_b**2, 0.0)
    covariance = mean(a * b) - mean_a * mean_b
    luminance = (2 * mean_a * mean_b + _SSIM_C1) / (mean_a**2 + mean_b**2 + _SSIM_C1)
    return np.asarray(luminance * (2 * covariance + _SSIM_C2) / (variances + _SSIM_C2))


def checked(
    render: ArrayLike, reference: ArrayLike, mask: NDArray[np.bool_] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Both images as `[H, W, C]` float64 and the pixels `[H, W]` that count; raises as said above."""
    a, b = np.asarray(render, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    if a.shape != b.shape or a.ndim not in (2, 3):
        raise ValueError(f"images are [H, W] or [H, W, C] of one shape; got {a.shape} and {b.shape}")
    if a.ndim == 2:
        a, b = a[..., None], b[..., None]
    inside = np.ones(a.shape[:2], dtype=bool) if mask is None else np.asarray(mask)
    if inside.shape != a.shape[:2] or inside.dtype != bool:
        raise ValueError(f"the mask is [H, W] bool = {a.shape[:2]}; got {inside.shape} {inside.dtype}")
    if not inside.any():
        raise ValueError("the mask leaves no pixel to compare")
    if not (np.isfinite(a[inside]).all() and np.isfinite(b[inside]).all()):
        raise ValueError("an image holds NaN or infinity inside the mask")
    return a, b, inside
