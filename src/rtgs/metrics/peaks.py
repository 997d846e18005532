"""How well a render keeps the strongest small extremes of its photograph: loose contacts, wet patches. A mean error hardly notices them.

A peak is a pixel of the slightly smoothed photograph that is the warmest (coldest) around, and warmer (colder) than four fifths of a ring
around it. So the inside, the straight edges and the corners of a large warm area are no peaks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from rtgs.metrics.basic import checked

REACH_PX = 2  # the render's extreme is looked for so far around the photograph's
RING_PX = 7  # radius of the ring that stands for the surroundings: beyond a peak of 8 px at half maximum
RING_SHARE = 0.8  # of the ring that is less extreme than a peak: at a corner of a warm area, three quarters are
APART_PX = 10  # no two peaks are nearer to each other than this
MOST = 10  # peaks of each sign
NOISE_FACTOR = (
    5.0  # a peak stands out by so many standard deviations of the noise, in a picture that is smoothed over 3 × 3 pixels
)

_MEDIAN_OF_ABSOLUTE = 0.6745  # of a normal distribution of standard deviation 1
_SMOOTHING = np.outer([1.0, 2.0, 1.0], [1.0, 2.0, 1.0]) / 16
_LAPLACIAN = np.array(
    [[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]
)  # blind to planes; noise comes out six times as large


@dataclass(frozen=True, eq=False)
class Peaks:
    """The strongest small extremes of a photograph, by strength, hot ones first.

    Attributes:
        rows, columns: `[K]` int, pixels.
        signs: `[K]`, 1 hot and −1 cold.
        values: `[K]`, the photograph's extreme there, within 1 pixel.
        strengths: `[K]`, by how much the smoothed photograph is beyond that share of the ring, > 0.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    signs: NDArray[np.int64]
    values: NDArray[np.float64]
    strengths: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.rows)


def find_peaks(photograph: ArrayLike, *, mask: NDArray[np.bool_] | None = None) -> Peaks:
    """Up to 10 hot and 10 cold peaks of an image `[H, W]`, well apart.

    Args:
        mask: `[H, W]` bool: only true pixels count. The ring around a peak lies in the image and on true pixels.

    Raises:
        ValueError: as `rtgs.metrics.basic` says.
    """
    image, _, inside = checked(photograph, photograph, mask)
    values = np.where(inside, image[..., 0], 0.0)
    distance = np.hypot(*np.mgrid[-RING_PX : RING_PX + 1, -RING_PX : RING_PX + 1])
    usable = ndimage.binary_erosion(inside, distance < RING_PX + 0.5)
    ring = np.abs(distance - RING_PX) < 0.5
    smooth = ndimage.convolve(values, _SMOOTHING, mode="reflect")  # single bad pixels and the tails of the noise are no peaks
    threshold = NOISE_FACTOR * noise_of(values, usable)
    found = []
    for sign in (1, -1):
        extreme = ndimage.maximum_filter(sign * smooth, 2 * REACH_PX + 1) == sign * smooth
        contrast = sign * smooth - ndimage.percentile_filter(sign * smooth, 100 * RING_SHARE, footprint=ring)
        nearby = sign * ndimage.maximum_filter(sign * values, 3)
        rows, columns = np.nonzero(extreme & usable & (contrast > threshold))
        strengths = contrast[rows, columns]
        for k in _apart(rows, columns, strengths):
            found.append((rows[k], columns[k], sign, nearby[rows[k], columns[k]], strengths[k]))
    table = np.array(found, dtype=np.float64).reshape(-1, 5)
    rows, columns, signs = table[:, :3].T.astype(np.int64)
    return Peaks(rows, columns, signs, values=table[:, 3], strengths=table[:, 4])


def peak_errors(render: ArrayLike, photograph: ArrayLike, *, mask: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
    """`[K]`: for each peak of the photograph, |extreme of the render within ± 2 px − the peak's value|, in the images' own unit.

    Empty where the photograph has no peak. Arguments and errors are those of `rtgs.metrics.basic`.
    """
    a, b, inside = checked(render, photograph, mask)
    peaks = find_peaks(b[..., 0], mask=inside)
    width = 2 * REACH_PX + 1
    shown = np.where(inside, a[..., 0], 0.0)
    warmest, coldest = (f(shown, width)[peaks.rows, peaks.columns] for f in (ndimage.maximum_filter, ndimage.minimum_filter))
    return np.abs(np.where(peaks.signs > 0, warmest, coldest) - peaks.values)


def noise_of(image: NDArray[np.float64], inside: NDArray[np.bool_]) -> float:
    """Standard deviation of an image's noise, from the median of its second differences (after Immerkær 1996); 0 without a pixel."""
    if not inside.any():
        return 0.0
    second = ndimage.convolve(image, _LAPLACIAN, mode="reflect")[inside]
    return float(np.median(np.abs(second))) / _MEDIAN_OF_ABSOLUTE / float(np.linalg.norm(_LAPLACIAN))


def _apart(rows: NDArray[np.int64], columns: NDArray[np.int64], strengths: NDArray[np.float64]) -> list[int]:
    """Indices of the strongest, none near a stronger one."""
    chosen: list[int] = []
    for k in np.argsort(-strengths, kind="stable"):
        if all(np.hypot(rows[k] - rows[c], columns[k] - columns[c]) >= APART_PX for c in chosen):
            chosen.append(int(k))
        if len(chosen) == MOST:
            break
    return chosen
