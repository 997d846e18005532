"""Structural similarity for training: one fused pass for the value and its gradient, on the CPU.

SSIM of Wang et al., "Image quality assessment: from error visibility to structural similarity" (2004), with the customary 11 × 11
Gaussian window (σ = 1.5 px) and data range 1:

    S = (2 μa μb + C1)(2 σab + C2) / ((μa² + μb² + C1)(σa² + σb² + C2)),    C1 = 0.01², C2 = 0.03².

**Borders.** Only windows that lie wholly inside the image count, so the map is `[H − 10, W − 10]`. torchmetrics' map has the same
values there, and around them a frame that it makes up by reflection; 3DGS's own loss zero-pads, which compares invented black
frames. Border pixels still receive gradient here, from the windows that reach them.

**Letters.** With window weights w, μa = w∗a, E[aa] = w∗a², E[ab] = w∗(a·b), σa² = E[aa] − μa², σab = E[ab] − μa μb. Only the sum
σa² + σb² occurs, so E[aa] + E[bb] is one moment. `reference_ssim` is the specification in plain torch; the Numba kernels are tested
against it.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray
from torch import Tensor

from rtgs.base.compiled import inlined, kernel

SIGMA_PX = 1.5
RADIUS_PX = 5
C1 = 0.01**2
C2 = 0.03**2


def window_taps() -> NDArray[np.float64]:
    """`[11]` taps of the separable window; they sum to one."""
    x = np.arange(-RADIUS_PX, RADIUS_PX + 1)
    g = np.exp(-(x**2) / (2 * SIGMA_PX**2))
    return g / g.sum()


def ssim(a: Tensor, b: Tensor, mask: Tensor | None = None) -> Tensor:
    """Mean SSIM of two images, differentiable in the first.

    float32 on the CPU goes through the fused kernels, anything else through `reference_ssim`.

    Args:
        a: `[H, W, C]` in [0, 1], H and W at least 11; the image that is fitted.
        b: `[H, W, C]`, the target. **It gets no gradient**, whether or not it asks for one.
        mask: `[H, W]` bool. The mean is then over the windows *centred* on a true pixel (and inside the image). Windows reach
            5 px around their centre; `whole_windows(mask)` keeps the centres whose window sees true pixels only.

    Returns:
        Scalar tensor of `a`'s dtype, in [−1, 1]; 1 for equal images.

    Raises:
        ValueError: shapes differ, are smaller than the window, or the mask leaves no window.
    """
    _check(a, b, mask)
    if a.dtype != torch.float32 or a.device.type != "cpu" or a.shape[2] > _MOST_CHANNELS:
        return reference_ssim(a, b.detach().to(a.dtype), mask)
    result: Tensor = _FusedSsim.apply(a, b.detach(), mask)
    return result


def reference_ssim(a: Tensor, b: Tensor, mask: Tensor | None = None) -> Tensor:
    """The same number in plain torch, any dtype, differentiable in both images: what the kernels are tested against."""
    count = _check(a, b, mask)
    values = reference_ssim_map(a, b)
    if mask is None:
        return values.mean()
    return (values * _centres(mask)[..., None]).sum() / (count * a.shape[2])


def reference_ssim_map(a: Tensor, b: Tensor) -> Tensor:
    """`[H − 10, W − 10, C]`: S at every window inside the image, from `[H, W, C]`."""
    channels = a.shape[2]
    taps = torch.as_tensor(window_taps(), dtype=a.dtype, device=a.device)
    stack = torch.cat([a, b, a * a, b * b, a * b], dim=2).permute(2, 0, 1)[None].contiguous()  # one filter over all moments
    n = 5 * channels
    blurred = torch.nn.functional.conv2d(stack, taps.view(1, 1, -1, 1).repeat(n, 1, 1, 1), groups=n)
    blurred = torch.nn.functional.conv2d(blurred, taps.view(1, 1, 1, -1).repeat(n, 1, 1, 1), groups=n)
    mu_a, mu_b, e_aa, e_bb, e_ab = blurred[0].permute(1, 2, 0).split(channels, dim=2)
    luminance = (2 * mu_a * mu_b + C1) / (mu_a**2 + mu_b**2 + C1)
    structure = (2 * (e_ab - mu_a * mu_b) + C2) / (e_aa - mu_a**2 + e_bb - mu_b**2 + C2)
    return luminance * structure


def whole_windows(mask: Tensor) -> Tensor:
    """`[H, W]` bool: centres whose whole 11 × 11 window lies inside the image and sees only true pixels of `mask` `[H, W]`."""
    size = 2 * RADIUS_PX + 1
    outside = (~mask).to(torch.float32)[None, None]
    padded = torch.nn.functional.pad(outside, (RADIUS_PX,) * 4, value=1.0)
    return torch.nn.functional.max_pool2d(padded, size, stride=1)[0, 0] < 0.5


def _centres(mask: Tensor) -> Tensor:
    return mask[RADIUS_PX:-RADIUS_PX, RADIUS_PX:-RADIUS_PX]


def _check(a: Tensor, b: Tensor, mask: Tensor | None) -> int:
    """Number of windows that count, per channel."""
    if a.ndim != 3 or a.shape != b.shape:
        raise ValueError(f"ssim compares two [H, W, C] images of one shape; got {tuple(a.shape)} and {tuple(b.shape)}")
    height, width = a.shape[:2]
    if min(height, width) <= 2 * RADIUS_PX:
        raise ValueError(f"ssim needs at least {2 * RADIUS_PX + 1} px a side; got {width} × {height}")
    if mask is None:
        return (height - 2 * RADIUS_PX) * (width - 2 * RADIUS_PX)
    if mask.shape != a.shape[:2] or mask.dtype != torch.bool:
        raise ValueError(f"ssim's mask is [H, W] bool = {(height, width)}; got {tuple(mask.shape)} {mask.dtype}")
    count = int(_centres(mask).sum())
    if count == 0:
        raise ValueError("ssim's mask leaves no window inside the image")
    return count


class _FusedSsim(torch.autograd.Function):
    """The gradient is computed in the forward call: its inputs are then still in cache and nothing but the result is kept."""

    @staticmethod
    def forward(ctx: Any, a: Tensor, b: Tensor, mask: Tensor | None) -> Tensor:
        a_image, b_image = (t.detach().to(torch.float32).contiguous().numpy() for t in (a, b))
        value, gradient = ssim_and_gradient(a_image, b_image, None if mask is None else mask.contiguous().numpy())
        ctx.save_for_backward(torch.from_numpy(gradient))
        return a.new_tensor(value)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: Tensor) -> tuple[Tensor | None, None, None]:
        (gradient,) = ctx.saved_tensors
        return gradient * grad_outputs[0], None, None


def ssim_and_gradient(
    a: NDArray[np.float32], b: NDArray[np.float32], mask: NDArray[np.bool_] | None = None, *, first: int = 0, stride: int = 1
) -> tuple[float, NDArray[np.float32]]:
    """Mean SSIM of `a` and `b` and its gradient in `a`.

    Args:
        a, b: `[H, W, C]`, C-contiguous, at least 11 px a side.
        mask: `[H, W]`, centres of the windows that count; at least one must be left.
        first, stride: only the window rows first, first + stride, … count. Two rows apart, windows share four fifths of their
            pixels and the mean hardly changes, at half the work.

    Returns:
        The value, and its gradient `[H, W, C]`.

    Raises:
        ValueError: the images are smaller than the window, or the mask leaves none.
    """
    height, width, channels = a.shape
    if min(height, width) <= 2 * RADIUS_PX:
        raise ValueError(f"ssim needs at least {2 * RADIUS_PX + 1} px a side; got {width} × {height}")
    rows = range(first, height - 2 * RADIUS_PX, stride)
    if mask is None:
        count = len(rows) * (width - 2 * RADIUS_PX)
        centres = np.zeros((0, 0), np.bool_)
    else:
        centres = mask[RADIUS_PX + first : height - RADIUS_PX : stride, RADIUS_PX:-RADIUS_PX]
        count = int(np.count_nonzero(centres))
        centres = np.ascontiguousarray(centres)
    if count == 0:
        if stride == 1:
            raise ValueError("ssim's mask leaves no window inside the image")
        return ssim_and_gradient(a, b, mask)  # what the mask leaves lies between these rows
    flat = (height, width * channels)
    row_sums = np.empty(len(rows))
    margin = -(-2 * RADIUS_PX // stride)
    # w∗∂S/∂(μa, E[aa], E[ab]) along the row, between rows of zeros: the adjoint of a 'valid' filter is the same filter on the map
    # in a frame of zeros.
    slopes = np.empty((3, len(rows) + 2 * margin, width * channels), np.float32)
    slopes[:, :margin], slopes[:, len(rows) + margin :] = 0.0, 0.0
    gradient = np.empty_like(a)
    weight = np.float32(1.0 / (count * channels))
    a_rows, b_rows = a.reshape(flat), b.reshape(flat)
    _similarity_rows(a_rows, b_rows, centres, channels, weight, first, stride, margin, row_sums, slopes)
    _gradient_rows(a_rows, b_rows, slopes, first, stride, margin, gradient.reshape(flat))
    return float(row_sums.sum()) / (count * channels), gradient


# --- kernels ---
# A row of an [H, W, C] image is W·C contiguous floats, and a horizontal tap is a step of C floats: no channel is taken apart.
# Rows are worked on in tiles of fixed width, with every intermediate at a fixed offset of one small buffer: they stay in cache
# and, the distances being compile-time constants, LLVM vectorises without a thicket of run-time alias checks.

_TAPS = window_taps().astype(np.float32)
_T0, _T1, _T2, _T3, _T4, _T5 = (numba.float32(t) for t in _TAPS[: RADIUS_PX + 1])
_TILE = 1024  # output floats a tile
_STRIDE = 2048  # floats between two quantities in a buffer: holds a tile and 2·RADIUS_PX pixels of up to 102 channels
_BAND = 8  # rows a thread takes at a time
_MOST_CHANNELS = (_STRIDE - _TILE) // (2 * RADIUS_PX)
_C1 = np.float32(C1)
_C2 = np.float32(C2)


@inlined
def _blur_along_row(source, at, count, step, out, to):  # type: ignore[no-untyped-def]
    """out[to + x] = Σ_k tap_k · source[at + x + k·step], taps paired by symmetry."""
    for x in range(count):
        i = at + x
        out[to + x] = (
            _T0 * (source[i] + source[i + 10 * step])
            + _T1 * (source[i + step] + source[i + 9 * step])
            + _T2 * (source[i + 2 * step] + source[i + 8 * step])
            + _T3 * (source[i + 3 * step] + source[i + 7 * step])
            + _T4 * (source[i + 4 * step] + source[i + 6 * step])
            + _T5 * source[i + 5 * step]
        )


@kernel("fast")
def _blur_tile(source, quantities, count, channels, out):  # type: ignore[no-untyped-def]
    # Literal steps make the tap distances constants, which doubles the speed; other channel counts take the general loop.
    for q in range(quantities):
        at = q * _STRIDE
        if channels == 3:
            _blur_along_row(source, at, count, 3, out, at)
        elif channels == 1:
            _blur_along_row(source, at, count, 1, out, at)
        else:
            _blur_along_row(source, at, count, channels, out, at)


@kernel("fast")
def _moments_of_columns(a, b, top, left, count, taps, out):  # type: ignore[no-untyped-def]
    """Vertical half of the four moments a, b, aa + bb, ab for the window rows top … top + 10."""
    middle_a, middle_b, tap = a[top + 5, left : left + count], b[top + 5, left : left + count], taps[5]
    for x in range(count):
        p, q = middle_a[x], middle_b[x]
        out[x] = tap * p
        out[_STRIDE + x] = tap * q
        out[2 * _STRIDE + x] = tap * (p * p + q * q)
        out[3 * _STRIDE + x] = tap * p * q
    for k in range(5):
        above_a, below_a = a[top + k, left : left + count], a[top + 10 - k, left : left + count]
        above_b, below_b = b[top + k, left : left + count], b[top + 10 - k, left : left + count]
        tap = taps[k]
        for x in range(count):
            p, q, r, s = above_a[x], above_b[x], below_a[x], below_b[x]
            out[x] += tap * (p + r)
            out[_STRIDE + x] += tap * (q + s)
            out[2 * _STRIDE + x] += tap * ((p * p + r * r) + (q * q + s * s))
            out[3 * _STRIDE + x] += tap * (p * q + r * s)


@kernel("fast")
def _similarity_of_moments(moments, weights, count, slopes):  # type: ignore[no-untyped-def]
    """Σ weight · S over the tile, and weight · ∂S/∂(μa, E[aa], E[ab]) into `slopes`."""
    total = np.float32(0.0)
    for x in range(count):
        mu_a, mu_b = moments[x], moments[_STRIDE + x]
        var = moments[2 * _STRIDE + x] - mu_a * mu_a - mu_b * mu_b
        cov = moments[3 * _STRIDE + x] - mu_a * mu_b
        n1 = np.float32(2.0) * mu_a * mu_b + _C1
        n2 = np.float32(2.0) * cov + _C2
        d1 = mu_a * mu_a + mu_b * mu_b + _C1
        d2 = var + _C2
        inverse = np.float32(1.0) / (d1 * d2)
        s = n1 * n2 * inverse
        w = weights[x]
        total += w * s
        w *= inverse
        # ∂S/∂E[aa] = −S/d2, ∂S/∂E[ab] = 2 n1/(d1 d2); μa enters through n1 and d1, and through σa² and σab with −2μa and −μb.
        slopes[x] = np.float32(2.0) * w * (mu_b * (n2 - n1) + mu_a * s * (d1 - d2))
        slopes[_STRIDE + x] = -w * s * d1
        slopes[2 * _STRIDE + x] = np.float32(2.0) * w * n1
    return total


@inlined
def _row(source, y, left):  # type: ignore[no-untyped-def]
    return source[y, left:]


@kernel("fast")
def _columns_of(source, top, rows, left, count, taps, out, to):  # type: ignore[no-untyped-def]
    """Vertical half of one filter: out[to + x] = Σ_k taps_k · source[top + k, left + x] over `rows` rows."""
    # Three rows a sweep: one over all would need more alias checks than LLVM emits, and one a row stores too often.
    for k in range(0, rows, 3):
        r0 = _row(source, top + k, left)
        r1, r2 = _row(source, top + min(k + 1, rows - 1), left), _row(source, top + min(k + 2, rows - 1), left)
        t0, t1, t2 = taps[k], taps[k + 1], taps[k + 2]
        if k == 0:
            for x in range(count):
                out[to + x] = t0 * r0[x] + t1 * r1[x] + t2 * r2[x]
        else:
            for x in range(count):
                out[to + x] += t0 * r0[x] + t1 * r1[x] + t2 * r2[x]


@kernel("fast")
def _blur_row(source, count, channels, out):  # type: ignore[no-untyped-def]
    """`out` `[count]` from `source` `[count + 10·C]`; the steps are literal for the reason given at `_blur_tile`."""
    if channels == 3:
        _blur_along_row(source, 0, count, 3, out, 0)
    elif channels == 1:
        _blur_along_row(source, 0, count, 1, out, 0)
    else:
        _blur_along_row(source, 0, count, channels, out, 0)


@kernel("fast", parallel=True, checks_division=True)
def _similarity_rows(  # type: ignore[no-untyped-def]
    a, b, centres, channels, weight, first, stride, margin, row_sums, slopes
):
    """row_sums[k] = Σ_x S of window row first + k·stride (masked, unweighted).

    `slopes` `[3, rows + 2·margin, W·C]`, from row `margin` on: weight · ∂S/∂moments, blurred along the row.
    """
    n = a.shape[1] - 2 * RADIUS_PX * channels
    reach = 2 * RADIUS_PX * channels
    for band in prange((len(row_sums) + _BAND - 1) // _BAND):
        columns = np.empty(4 * _STRIDE, np.float32)
        moments = np.empty(4 * _STRIDE, np.float32)
        slope = np.empty(3 * _STRIDE, np.float32)
        weights = np.ones(_TILE, np.float32)
        framed = np.zeros((3, n + 2 * reach), np.float32)
        for k in range(band * _BAND, min(len(row_sums), (band + 1) * _BAND)):
            total = 0.0
            for left in range(0, n, _TILE):
                count = min(_TILE, n - left)
                _moments_of_columns(a, b, first + k * stride, left, count + reach, _TAPS, columns)
                _blur_tile(columns, 4, count, channels, moments)
                if centres.size > 0:
                    for x in range(count):
                        weights[x] = centres[k, (left + x) // channels]
                total += _similarity_of_moments(moments, weights, count, slope)
                for q in range(3):
                    inside = framed[q, reach + left : reach + left + count]
                    for x in range(count):
                        inside[x] = weight * slope[q * _STRIDE + x]
            row_sums[k] = total
            for q in range(3):
                _blur_row(framed[q], n + reach, channels, slopes[q, k + margin])


@kernel("fast", parallel=True, checks_division=True)
def _gradient_rows(a, b, slopes, first, stride, margin, gradient):  # type: ignore[no-untyped-def]
    """∂/∂a = w∗(∂S/∂μa) + 2a · w∗(∂S/∂E[aa]) + b · w∗(∂S/∂E[ab]): the chain rule through three symmetric filters."""
    rows, n = a.shape
    for band in prange((rows + _BAND - 1) // _BAND):
        slope = np.empty(3 * _STRIDE, np.float32)
        taps = np.zeros(2 * RADIUS_PX + 3, np.float32)
        for y in range(band * _BAND, min(rows, (band + 1) * _BAND)):
            # The windows that hold row y start at rows y − 10 … y; of these, first + k·stride for k from `lowest` on.
            lowest = -((first - y + 2 * RADIUS_PX) // stride)
            highest = (y - first) // stride
            taps[:] = 0.0
            for k in range(lowest, highest + 1):
                taps[k - lowest] = _TAPS[y - first - k * stride]
            for left in range(0, n, _TILE):
                count = min(_TILE, n - left)
                for q in range(3):
                    _columns_of(slopes[q], lowest + margin, highest - lowest + 1, left, count, taps, slope, q * _STRIDE)
                a_row, b_row, out = a[y, left : left + count], b[y, left : left + count], gradient[y, left : left + count]
                for x in range(count):
                    out[x] = slope[x] + np.float32(2.0) * a_row[x] * slope[_STRIDE + x] + b_row[x] * slope[2 * _STRIDE + x]
