"""The pattern that a thermal sensor adds to all of its images: vignetting, and readout noise of rows and columns."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

FEWEST_FRAMES = 8  # a median over fewer holds too much of the scene
_AGREEMENT = 0.7  # correlation of the row (column) levels of two halves of the frames: readout noise is the same in both
_SMOOTH_PX = 3.0  # standard deviation of the filter whose output is the scene's course, and not readout noise


def sensor_pattern(images: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """`[h, w]`: the part of all images `[F, h, w]` that stays in the same place and has the shape of a sensor's error.

    Of the median over frames it has two parts. One is a quadratic surface: vignetting, and the warmth of the housing. The other is the
    fine part of the levels of rows and columns: readout noise. The second part needs two halves of the frames to agree about it.

    The median itself would hold the scene wherever the scene stays in the same place of the images, as in an orbit. The median of a
    row, compared with the rows beside it, does not.

    Args:
        mask: `[h, w]`, valid pixels.

    Returns:
        0 where masked, and everywhere if there are fewer than 8 frames.
    """
    if len(images) < FEWEST_FRAMES or mask.sum() < 100:
        return np.zeros(mask.shape, np.float32)
    middle = _median(images, axis=0).astype(np.float64)
    surface = _quadratic(middle, mask)
    halves = [_median(images[k::2], axis=0) - surface for k in (0, 1)]
    pattern = surface - surface[mask].mean()
    for axis in (0, 1):
        levels = _fine_levels(middle - surface, mask, axis)
        first, second = (_fine_levels(half, mask, axis) for half in halves)
        size = math.sqrt(float(first @ first) * float(second @ second))
        if size > 0 and float(first @ second) / size > _AGREEMENT:
            pattern = pattern + np.expand_dims(levels, 1 - axis)
    return np.where(mask, pattern, 0.0).astype(np.float32)


def quadratic_terms(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """`[6, h, w]`: 1, x, y, x², y² and x·y, with x and y from −1 to 1."""
    y, x = (np.linspace(-1.0, 1.0, n) for n in shape)
    return np.stack(
        np.broadcast_arrays(1.0 + 0 * y[:, None], x[None], y[:, None], x[None] ** 2, y[:, None] ** 2, y[:, None] * x[None])
    )


def _quadratic(image: NDArray[np.float64], mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    terms = quadratic_terms(image.shape)
    matrix, right = torch.from_numpy(terms[:, mask].T), torch.from_numpy(image[mask])[:, None]
    weights = torch.linalg.lstsq(matrix, right).solution  # NumPy's has threads of its own, which the fit cannot limit
    return np.asarray(np.einsum("k,khw->hw", weights[:, 0].numpy(), terms))


def _fine_levels(image: NDArray[np.float64], mask: NDArray[np.bool_], axis: int) -> NDArray[np.float64]:
    """`[h]` or `[w]`: the median of each row (`axis` 0) or column (1), after a smooth course along that axis is subtracted."""
    filled = np.where(mask, image, np.median(image[mask]))
    fine = np.where(mask, filled - gaussian_filter1d(filled, _SMOOTH_PX, axis=axis), np.nan)
    seen = np.asarray(mask.any(axis=1 - axis))
    levels = np.zeros(len(seen))
    levels[seen] = _median(np.compress(seen, fine, axis=axis), axis=1 - axis)
    return levels


def _median(values: NDArray[Any], axis: int) -> NDArray[Any]:
    """The median of what is not NaN, in lines that have such values. Sorts all lines at once; NumPy's nanmedian sorts one by one."""
    ordered = np.sort(values, axis=axis)  # NaN last
    count = np.isfinite(values).sum(axis=axis, keepdims=True)
    low, high = (np.take_along_axis(ordered, k, axis=axis) for k in ((count - 1) // 2, count // 2))
    return np.asarray(((low + high) / 2).squeeze(axis))
