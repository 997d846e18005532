"""What a board is: its points, and the orders in which a detector may list them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.calibration import checkerboard
from rtgs.calibration.checkerboard import Sighting
from rtgs.config.calibration import BoardConfig

_LEAST_POINTS = 8  # of a ChArUco board that is partly hidden


@dataclass(frozen=True, eq=False)
class Board:
    """A flat board with known points.

    Attributes:
        config: kind, numbers and sizes.
        points: `[n, 3]`, metres, in the plane z = 0; z points away from a camera that sees the board.
    """

    config: BoardConfig
    points: NDArray[np.float64]

    @cached_property
    def orders(self) -> tuple[NDArray[np.intp], ...]:
        """Permutations `[n]` of the points that a detector cannot tell apart: turns of the board that map its points to themselves.

        The first one keeps the order. Points with markers have no other.
        """
        if self.config.board == "charuco":
            return (np.arange(len(self.points)),)
        flat = self.points[:, :2] - self.points[:, :2].mean(axis=0)
        found = []
        for quarter in range(4):
            c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
            turned = flat @ np.array([[c, s], [-s, c]])
            distance = np.linalg.norm(turned[:, None] - flat[None], axis=2)
            if distance.min(axis=1).max() < 1e-6 * self.config.square_m:
                found.append(distance.argmin(axis=1))
        return tuple(found)

    def find(self, picture: NDArray[np.float32], *, explain: bool = True) -> Sighting | str:
        """Find the board in a picture `[h, w]` of any unit, dark or bright squares; or say in words why it cannot be used.

        explain: look closer at a picture without the board, which takes twice as long as the search.
        """
        if self.config.board == "checkerboard":
            return checkerboard.find(picture, *self.config.size, explain=explain)
        return (_find_charuco if self.config.board == "charuco" else _find_circles)(self.config, picture)


def make_board(config: BoardConfig) -> Board:
    """The board that the settings describe.

    Raises:
        RtgsError: no such dictionary of markers, or too few markers in it.
    """
    columns, rows = config.size
    x, y = (part.ravel().astype(np.float64) for part in np.meshgrid(np.arange(columns), np.arange(rows)))
    if config.board == "circles":
        x = 2 * x + y % 2
    if config.board == "charuco":
        _charuco(config)
    return Board(config, config.square_m * np.stack([x, y, np.zeros_like(x)], axis=1))


def _charuco(config: BoardConfig) -> cv2.aruco.CharucoBoard:
    columns, rows = config.size
    number = getattr(cv2.aruco, config.dictionary, None)
    if not config.dictionary.startswith("DICT_") or number is None:
        raise RtgsError(f"dictionary is {config.dictionary!r}, which OpenCV does not have; DICT_4X4_50 is one.")
    dictionary = cv2.aruco.getPredefinedDictionary(number)
    if len(dictionary.bytesList) < (columns + 1) * (rows + 1) // 2:
        raise RtgsError(f"dictionary {config.dictionary} has too few markers for {columns + 1}×{rows + 1} squares.")
    assert config.marker_m is not None
    return cv2.aruco.CharucoBoard((columns + 1, rows + 1), config.square_m, config.marker_m, dictionary)


def _find_charuco(config: BoardConfig, picture: NDArray[np.float32]) -> Sighting | str:
    detector, most = cv2.aruco.CharucoDetector(_charuco(config)), 0
    for grey in checkerboard.stretched(picture):
        for polarity in (grey, 255 - grey):
            corners, ids = detector.detectBoard(polarity)[:2]
            most = max(most, 0 if ids is None else len(ids))
            if ids is not None and len(ids) >= _LEAST_POINTS:
                return Sighting(ids.ravel().astype(np.intp), corners.reshape(-1, 2).astype(np.float64))
    return f"{most} corners with markers were found, and {_LEAST_POINTS} are needed: the board is missing, cut, blurred or of another kind"


def _find_circles(config: BoardConfig, picture: NDArray[np.float32]) -> Sighting | str:
    columns, rows = config.size
    for grey in checkerboard.stretched(picture):
        for polarity in (grey, 255 - grey):
            found, centres = cv2.findCirclesGrid(polarity, (columns, rows), flags=cv2.CALIB_CB_ASYMMETRIC_GRID)
            if found:
                return Sighting(np.arange(columns * rows), centres.reshape(-1, 2).astype(np.float64))
    return f"no grid of {columns}×{rows} circles was found: the board is missing, cut or blurred"
