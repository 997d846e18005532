"""The inner corners of a checkerboard, to a fraction of a pixel.

1. Find the board in a reduced picture of either polarity. A reduced one has less clutter and fewer false corners.
2. Straighten the board: resample the full picture so that all squares have one size, with the board's own range of values.
3. Locate the corners there by OpenCV's sector-based detector, and map them back.

Pixels are OpenCV's here: the centre of the first one is (0, 0).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

_SIDES = (512, 1024)  # longest sides of the reduced pictures
_SQUARE_PX = 60  # of the straightened board
_MARGIN = 0.95  # of a square, around the outer corners
_PERCENTILES = (0.5, 99.5)
_MAX_MOVE = 0.3  # of a square: the two detectors mean the same corner
_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_LEAST = 3  # corners on a side


@dataclass(frozen=True, eq=False)
class Sighting:
    """A board in a picture.

    Attributes:
        ids: `[n]`, which of the board's points.
        pixels: `[n, 2]`, pixel centres at integers.
    """

    ids: NDArray[np.intp]
    pixels: NDArray[np.float64]


def find(picture: NDArray[np.float32], columns: int, rows: int, *, explain: bool = True) -> Sighting | str:
    """The inner corners row by row, or in words why the picture cannot be used.

    Args:
        picture: `[h, w]`, any unit.
        columns, rows: of inner corners.
        explain: where there is no board, look whether it is a part of one.
    """
    rough = _rough(picture, columns, rows)
    if rough is None:
        return (
            _part(picture, columns, rows) if explain else ""
        ) or f"no checkerboard of {columns}×{rows} inner corners was found"
    exact = _exact(picture, rough, columns, rows)
    if exact is None:
        return "the board was found, but its corners cannot be located: it is blurred, cut, or partly hidden"
    return Sighting(np.arange(columns * rows), exact)


def stretched(picture: NDArray[np.float32]) -> Iterator[NDArray[np.uint8]]:
    """The picture in 8 bits: its whole range first, then with the contrast of each part raised."""
    yield _stretch(picture)
    low, high = float(picture.min()), float(picture.max())
    deep = ((picture - low) * (65535.0 / max(high - low, 1e-12))).astype(np.uint16)
    yield _stretch(cv2.createCLAHE(8.0, (6, 6)).apply(deep).astype(np.float32))


def _stretch(picture: NDArray[np.float32]) -> NDArray[np.uint8]:
    low, high = np.percentile(picture, _PERCENTILES)
    return np.clip((picture - low) * (255.0 / max(high - low, 1e-12)), 0, 255).astype(np.uint8)


def _rough(picture: NDArray[np.float32], columns: int, rows: int) -> NDArray[np.float64] | None:
    """`[n, 2]`, good to a few pixels."""
    for grey in stretched(picture):
        longest = max(grey.shape)
        for side in _SIDES[: 1 + (longest > _SIDES[0])]:
            small = grey
            if longest > side:
                size = tuple(max(1, round(s * side / longest)) for s in grey.shape[::-1])
                small = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
            corners = _corners(small, columns, rows)
            if corners is not None:
                factor = np.array(grey.shape[::-1]) / np.array(small.shape[::-1])
                return _right_handed((corners + 0.5) * factor - 0.5, columns, rows)
    return None


def _corners(grey: NDArray[np.uint8], columns: int, rows: int) -> NDArray[np.float64] | None:
    for polarity in (grey, 255 - grey):
        found, corners = cv2.findChessboardCorners(polarity, (columns, rows), flags=_CLASSIC)
        if found:
            return corners.reshape(-1, 2).astype(np.float64)
    found, corners = cv2.findChessboardCornersSB(grey, (columns, rows), flags=cv2.CALIB_CB_ACCURACY)
    return corners.reshape(-1, 2).astype(np.float64) if found else None


def _right_handed(corners: NDArray[np.float64], columns: int, rows: int) -> NDArray[np.float64]:
    """Columns to the right and rows downwards, as seen from the front: never mirrored."""
    grid = corners.reshape(rows, columns, 2)
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    return (grid if along[0] * down[1] > along[1] * down[0] else grid[:, ::-1]).reshape(-1, 2)


def _exact(picture: NDArray[np.float32], rough: NDArray[np.float64], columns: int, rows: int) -> NDArray[np.float64] | None:
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    straight = (grid + _MARGIN) * _SQUARE_PX
    straight_from_picture, _ = cv2.findHomography(rough, straight)
    if straight_from_picture is None:
        return None
    size = (round((columns - 1 + 2 * _MARGIN) * _SQUARE_PX), round((rows - 1 + 2 * _MARGIN) * _SQUARE_PX))
    board = cv2.warpPerspective(picture, straight_from_picture, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    grey = _stretch(np.asarray(board, dtype=np.float32))
    found, corners = cv2.findChessboardCornersSB(grey, (columns, rows), flags=cv2.CALIB_CB_ACCURACY)
    if not found:
        return None
    corners = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    distance = np.linalg.norm(corners[None] - straight[:, None], axis=2)  # the list may start at another end of the board
    if distance.min(axis=1).max() > _MAX_MOVE * _SQUARE_PX:
        return None
    corners = corners[distance.argmin(axis=1)]
    back = np.linalg.inv(straight_from_picture)
    return np.asarray(cv2.perspectiveTransform(corners[:, None], back)[:, 0], dtype=np.float64)


def _part(picture: NDArray[np.float32], columns: int, rows: int) -> str:
    """That a part of the board can be seen: fewer of its columns or rows. Empty where there is none."""
    smaller = [(columns - c, rows - r) for c in range(3) for r in range(3) if c + r and min(columns - c, rows - r) >= _LEAST]
    factor = min(1.0, _SIDES[0] / max(picture.shape))
    small = np.asarray(cv2.resize(_stretch(picture), None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    for size in sorted(smaller, key=lambda s: -s[0] * s[1]):
        if _corners(small, *size) is not None:
            return (
                f"{size[0]}×{size[1]} of the {columns}×{rows} inner corners can be seen: the board is cut or partly hidden, or it has "
                "another number of squares"
            )
    return ""
