"""Hot spots in one rendered view: where a temperature stands out from the same surface around it, or is beyond a threshold.

Cold spots are those of the negated image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

RADII_PX = (5, 10, 20)  # of the rings that stand for the surroundings: of spots up to about these widths
PAIRS = 12  # of opposite pixels on a ring
RING_SHARE = (
    0.8  # of the ring that a spot is warmer than by the excess: at a straight edge about half is, at a corner three quarters
)
FLAT_SHARE = 0.1  # of the depth: opposite pixels of a ring have the centre's depth on average where the surface goes on
_FINER = 8  # points to a side of a pixel, of the image that is resolved
_COUNTED = 400  # pixels: the area of a larger region is counted
_MARGIN = 3  # pixels that are resolved around a region
_UPPER = 0.75  # of the excess: the top of a region, whose width says whether its pixels resolve it
_EDGE = 3  # pixels around a region whose median stands for its surroundings

Image = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Region:
    """A hot spot of an image.

    Attributes:
        rows, columns: `[K]`, its pixels. peak: row and column of the highest.
        surroundings: temperature around it.
        extreme: highest temperature, of the image as `resolved` has it. area_px: its area there, in pixels.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    peak: tuple[int, int]
    surroundings: float
    extreme: float
    area_px: float


def regions_by_excess(temperature: Image, depth: Image, excess: float) -> list[Region]:
    """Places that are warmer than the same surface around them, each as far as at least half of its excess goes.

    Args:
        temperature, depth: `[H, W]`; depth is NaN where nothing is.
        excess: least difference between the peak and its surroundings.
    """
    rows, columns = np.nonzero((ndimage.maximum_filter(temperature, 5) == temperature) & np.isfinite(depth))
    contrast, radius = standing_out(temperature, depth, rows, columns)
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
            extreme = highest(temperature, *region, surroundings)
            area = _area_px(np.maximum(temperature, surroundings), *region, surroundings + 0.5 * (extreme - surroundings))
            found.append(Region(*region, (row, column), surroundings, extreme, area))
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
        extreme, area = highest(temperature, rows, columns, around), _area_px(temperature, rows, columns, threshold)
        yield Region(rows, columns, (int(rows[at]), int(columns[at])), around, extreme, area)


def resolved(image: Image) -> Image:
    """`[8 H, 8 W]`: the cubic spline whose means over the pixels are the image.

    A pixel shows the mean over its area. It lowers the peak of a spot two pixels wide by a sixth, and makes it a quarter larger.
    """
    coefficients = ndimage.spline_filter(image, order=4, mode="mirror")  # a cubic B-spline's mean over a pixel is the quartic one
    down, across = (_spline_at_points(n) for n in image.shape)
    return np.asarray(down @ coefficients @ across.T)


@lru_cache(maxsize=256)
def _spline_at_points(pixels: int) -> Image:
    """`[8 n, n]`: values of a row of cubic B-splines at the finer points, from its coefficients."""
    at = (np.arange(pixels * _FINER) + 0.5) / _FINER - 0.5
    columns = [ndimage.map_coordinates(one, [at], order=3, prefilter=False, mode="mirror") for one in np.eye(pixels)]
    return np.stack(columns, axis=1)


def highest(temperature: Image, rows: NDArray[np.int64], columns: NDArray[np.int64], surroundings: float) -> float:
    """The highest temperature within some pixels, without what the mean over a pixel takes from it.

    Where the top of the region is three pixels wide or more, it is the top of the paraboloid through 3 × 3 pixels whose means are given.
    Elsewhere it is that of the spline, which overshoots at sharp edges: what is colder than the surroundings counts as these.
    """
    top, left = max(int(rows.min()) - 1, 0), max(int(columns.min()) - 1, 0)
    window = temperature[top : rows.max() + 2, left : columns.max() + 2]
    values = temperature[rows, columns]
    upper = np.zeros(window.shape, bool)
    upper[rows - top, columns - left] = values >= surroundings + _UPPER * (values.max() - surroundings)
    inner = ndimage.binary_erosion(upper, np.ones((3, 3)))
    if inner.any():
        row, column = np.unravel_index(np.where(inner, window, -np.inf).argmax(), window.shape)
        return _top(window[row - 1 : row + 2, column - 1 : column + 2])
    if len(rows) > _COUNTED:
        rows, columns = (part[values.argmax()][None] for part in (rows, columns))
    fine, own = _resolved_around(np.maximum(temperature, min(surroundings, values.min())), rows, columns)
    return float(fine[own].max())


def _top(means: Image) -> float:
    """The highest value in the middle pixel of the paraboloid that has these means over 3 × 3 pixels."""
    slope = np.array([means[2, 1] - means[0, 1], means[1, 2] - means[1, 0]]) / 2
    bend = np.array([means[2, 1] + means[0, 1], means[1, 2] + means[1, 0]]) - 2 * means[1, 1]
    across = (means[2, 2] - means[2, 0] - means[0, 2] + means[0, 0]) / 4
    hessian = np.array([[bend[0], across], [across, bend[1]]])
    steps = np.linspace(-0.5, 0.5, _FINER + 1)
    at = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    values = means[1, 1] - bend.sum() / 24 + at @ slope + 0.5 * np.einsum("yxi,ij,yxj->yx", at, hessian, at)
    return float(values.max())


def _area_px(temperature: Image, rows: NDArray[np.int64], columns: NDArray[np.int64], level: float) -> float:
    """Area in which a region reaches a level."""
    if len(rows) > _COUNTED:
        return float(len(rows))
    fine, own = _resolved_around(temperature, rows, columns)
    labels, _ = ndimage.label(fine >= level)
    reached = np.unique(labels[own])
    return float(np.isin(labels, reached[reached > 0]).sum()) / _FINER**2 or float(len(rows))


def _resolved_around(temperature: Image, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> tuple[Image, NDArray[np.bool_]]:
    """The image around some pixels, resolved, and which of its points lie in these pixels."""
    top, left = max(int(rows.min()) - _MARGIN, 0), max(int(columns.min()) - _MARGIN, 0)
    window = temperature[top : rows.max() + _MARGIN + 1, left : columns.max() + _MARGIN + 1]
    own = np.zeros(window.shape, bool)
    own[rows - top, columns - left] = True
    return resolved(window), own.repeat(_FINER, axis=0).repeat(_FINER, axis=1)


def standing_out(
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
