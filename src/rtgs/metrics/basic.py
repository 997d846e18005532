"""How close a render is to its reference: PSNR, SSIM, mean absolute error. NumPy in, one number out.

Every function takes `render` and `reference` as `[H, W]` or `[H, W, C]` of one shape, any float or integer type (computed in
float64), and `mask`, `[H, W]` bool: only its true pixels count. They raise ValueError when shapes differ or nothing is left to
count, and when a counted value is not finite: a NaN render must not pass for a score.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torchmetrics.functional.image import structural_similarity_index_measure

SSIM_RADIUS_PX = 5  # torchmetrics' Gaussian window at σ = 1.5 is 11 × 11


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
    """Mean structural similarity (Wang et al. 2004) of images in [0, 1], by torchmetrics.

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
    x, y = (torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None] for image in (a, b))
    # The mean is taken here because torchmetrics has changed over versions whether its own leaves the reflected border out.
    _, values = structural_similarity_index_measure(x, y, sigma=1.5, data_range=1.0, return_full_image=True)
    outside = torch.from_numpy(~inside).double()[None, None]
    reached = torch.nn.functional.max_pool2d(outside, 2 * SSIM_RADIUS_PX + 1, stride=1, padding=SSIM_RADIUS_PX)[0, 0]
    whole = reached < 0.5
    if not whole.any():
        raise ValueError("SSIM: no 11 × 11 window fits into the mask")
    return float(values[0, :, whole].mean())


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
