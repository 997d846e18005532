"""Settings of a calibration with a board."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, Literal

from rtgs.base.errors import RtgsError
from rtgs.config.ranges import Range, check_ranges

BoardKind = Literal["checkerboard", "charuco", "circles"]
_LEAST_CORNERS = 3


@dataclass(frozen=True)
class BoardConfig:
    """The board that stands in the pictures."""

    inner_corners: str
    """columns x rows of corners between squares, such as 6x5; of circles, the number in a row and the number of rows, such as 4x11"""
    square_m: Annotated[float, Range(above=0, most=100)]
    """side of a square, in metres, above 0 and at most 100; of circles, the distance between two rows"""
    board: BoardKind = "checkerboard"
    """checkerboard of either polarity, charuco, or circles: an asymmetric grid of them"""
    marker_m: Annotated[float | None, Range(above=0, most=100)] = None
    """charuco: side of a marker, in metres"""
    dictionary: str = "DICT_4X4_50"
    """charuco: OpenCV's name of the markers' dictionary"""

    def __post_init__(self) -> None:
        check_ranges(self)
        columns, rows = self.size
        if min(columns, rows) < _LEAST_CORNERS or max(columns, rows) > 100:
            raise RtgsError(f"inner_corners is {self.inner_corners}; both numbers are from {_LEAST_CORNERS} to 100.")
        if self.board == "charuco" and self.marker_m is None:
            raise RtgsError("marker_m is missing: a ChArUco board needs the side of its markers, in metres.")
        if self.marker_m is not None and self.marker_m >= self.square_m:
            raise RtgsError(f"marker_m is {self.marker_m:g}; a marker is smaller than its square of {self.square_m:g} m.")

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows of points.

        Raises:
            RtgsError: `inner_corners` is not two numbers.
        """
        match = re.fullmatch(r"(\d{1,4})[x×](\d{1,4})", self.inner_corners.strip())
        if match is None:
            raise RtgsError(f"inner_corners is {self.inner_corners!r}; columns x rows are expected, such as 6x5.")
        return int(match[1]), int(match[2])
