"""Hot spots in one rendered view: where a temperature stands out from the same surface around it, or is beyond a threshold.

Cold spots are those of the negated image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

RADII_PX = (5, 10, 20)  # of the rings that stand for the surroundings: of spots up to about these widths
PAIRS = 12  # of opposite pixels on a ring
RING_SHARE = (
    0.8  # of the ring that a spot is warmer than by the excess: at a straight edge about half is, at a corner three quarters
)
FLAT_SHARE = 0.05  # of the depth: opposite pixels of a ring have the centre's depth on average where the surface goes on
_FINER, _COUNTED = 4, 400  # interpolation of a small region's area, and the pixels from which a region is counted
_EDGE = 3  # pixels around a region whose median stands for its surroundings

Image = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Region:
    """A hot spot of an image.

    Attributes:
        rows, columns: `[K]`, its pixels. peak: row and column of the highest.
        surroundings: temperature around it.
        area_px: its area in pixels, of an interpolated image: a spot of two pixels is not told from one of three by counting.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    peak: tuple[int, int]
    surroundings: float
    area_px: float


def regions_by_excess(temperature: Image, depth: Image, excess: float) -> list[Region]:
    """Places that are warmer than the same surface around them, each as far as at least half of its excess goes.

    Args:
        temperature, depth: `[H, W]`; depth is NaN where nothing is.
        excess: least difference between the peak and its surroundings.
    """
    rows, columns = np.nonzero((ndimage.maximum_filter(temperature, 5) == temperature) & np.isfinite(depth))
    contrast, radius = _standing_out(temperature, depth, rows, columns)
    taken = np.zeros(temperature.shape, bool)
    found = []
    for k in np.argsort(-contrast, kind="stable"):
        row, column = int(rows[k]), int(columns[k])
        if contrast[k] < excess:
            break
        if taken[row, column]:
            continue
        surroundings = float(temperature[row, column] - contrast[k])
        level = surroundings + 0.5 * float(contrast[k])
        region = _grown(temperature, depth, (row, column), level, 2 * int(radius[k]))
        if region is not None:
            taken[region] = True
            found.append(Region(*region, (row, column), surroundings, _area_px(temperature, region, level)))
    return found


def regions_by_threshold(temperature: Image, depth: Image, threshold: float) -> Iterator[Region]:
    """Connected areas of a surface above a threshold."""
    inside = (temperature >= threshold) & np.isfinite(depth)
    labels, _ = ndimage.label(inside)
    for index, box in enumerate(ndimage.find_objects(labels), start=1):
        grown = tuple(slice(max(s.start - _EDGE, 0), s.stop + _EDGE) for s in box)
        own = labels[grown] == index
        rim = ndimage.binary_dilation(own, iterations=_EDGE) & (labels[grown] == 0)
        rows, columns = np.nonzero(own)
        values = temperature[grown][own]
        at = int(values.argmax())
        around = float(np.median(temperature[grown][rim])) if rim.any() else float(values.min())
        rows, columns = rows + grown[0].start, columns + grown[1].start
        area = _area_px(temperature, (rows, columns), threshold)
        yield Region(rows, columns, (int(rows[at]), int(columns[at])), around, area)


def _area_px(temperature: Image, region: tuple[NDArray[np.int64], NDArray[np.int64]], level: float) -> float:
    """Area of a region in which a level is reached, from a cubic interpolation. A region of many pixels is counted."""
    rows, columns = region
    if len(rows) > _COUNTED:
        return float(len(rows))
    top, left = max(int(rows.min()) - 2, 0), max(int(columns.min()) - 2, 0)
    window = temperature[top : rows.max() + 3, left : columns.max() + 3]
    fine = [(np.arange(n * _FINER) + 0.5) / _FINER - 0.5 for n in window.shape]
    inside = ndimage.map_coordinates(window, np.meshgrid(*fine, indexing="ij"), order=3, mode="nearest") >= level
    labels, _ = ndimage.label(inside)
    own = np.unique(labels[(rows - top) * _FINER + _FINER // 2, (columns - left) * _FINER + _FINER // 2])
    return float(np.isin(labels, own[own > 0]).sum()) / _FINER**2 or float(len(rows))


def _standing_out(
    temperature: Image, depth: Image, rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """`[K]` each: by how much a pixel is warmer than four fifths of the ring around it, and the radius of the ring where that is most.

    A pair of opposite pixels that leaves the surface counts as hotter than everything: where a fifth of the ring does, nothing stands out.
    """
    best, radius = np.full(len(rows), -np.inf), np.zeros(len(rows), np.int64)
    angles = np.arange(PAIRS) * np.pi / PAIRS
    for r in RADII_PX:
        half = np.rint(r * np.stack([np.sin(angles), np.cos(angles)])).astype(np.int64)
        dy, dx = np.concatenate([half, -half], axis=1)
        y, x = rows[:, None] + dy, columns[:, None] + dx
        inside = (y >= 0) & (y < temperature.shape[0]) & (x >= 0) & (x < temperature.shape[1])
        y, x = np.where(inside, y, 0), np.where(inside, x, 0)
        far = np.where(inside, depth[y, x], np.nan)
        middle, own = 0.5 * (far[:, :PAIRS] + far[:, PAIRS:]), depth[rows, columns][:, None]
        surface = np.tile(np.abs(middle - own) <= FLAT_SHARE * own, 2)  # False where a depth is NaN
        ring = np.where(surface, temperature[y, x], np.inf)
        kept = int(np.ceil(RING_SHARE * ring.shape[1])) - 1
        contrast = temperature[rows, columns] - np.partition(ring, kept, axis=1)[:, kept]
        radius, best = np.where(contrast > best, r, radius), np.maximum(contrast, best)
    return best, radius


def _grown(
    temperature: Image, depth: Image, peak: tuple[int, int], level: float, reach: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Rows and columns of the pixels around a peak that reach a level; None where they go on beyond the reach."""
    top, left = max(peak[0] - reach, 0), max(peak[1] - reach, 0)
    part = (slice(top, peak[0] + reach + 1), slice(left, peak[1] + reach + 1))
    labels, _ = ndimage.label((temperature[part] >= level) & np.isfinite(depth[part]))
    own = labels == labels[peak[0] - top, peak[1] - left]
    if labels[peak[0] - top, peak[1] - left] == 0:
        return None
    rows, columns = (i + o for i, o in zip(np.nonzero(own), (top, left), strict=True))
    if max(np.abs(rows - peak[0]).max(), np.abs(columns - peak[1]).max()) >= reach:
        return None
    return rows, columns
