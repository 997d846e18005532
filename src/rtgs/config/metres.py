"""Settings of the metres: which sources count, and distances known beforehand."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from rtgs.base.errors import RtgsError
from rtgs.config.ranges import Range, check_ranges

MetresSourceName = Literal["baseline", "gps", "distance", "board", "laser"]
METRES_SOURCES: tuple[MetresSourceName, ...] = get_args(MetresSourceName)


@dataclass(frozen=True)
class MetresConfig:
    """Where the metres come from."""

    sources: tuple[MetresSourceName, ...] = METRES_SOURCES
    """Which sources count, where the capture has them."""
    distance: tuple[str, ...] = ()
    """Known distances between the RGB cameras of two frames: frame, frame and metres, such as 0001 0020 3.5, and again for more. Their
    standard deviation is 0.5 %; metres.json of the capture can state another."""

    def __post_init__(self) -> None:
        check_ranges(self, "metres")
        if unknown := sorted(set(self.sources) - set(METRES_SOURCES)):
            raise RtgsError(f"metres.sources names {unknown[0]!r}; there are {', '.join(METRES_SOURCES)}.")
        if len(self.distance) % 3:
            raise RtgsError("metres.distance needs frame, frame and metres, three words for each distance.")
        for metres in self.distance[2::3]:
            if not 0 < _number(metres) < 1e6:
                raise RtgsError(f"metres.distance names the length {metres!r:.60}; it is a number of metres above 0.")

    @property
    def distances(self) -> tuple[tuple[str, str, float], ...]:
        """`distance` as (frame, frame, metres)."""
        words = self.distance
        return tuple((words[i], words[i + 1], float(words[i + 2])) for i in range(0, len(words), 3))


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


@dataclass(frozen=True)
class TagsConfig:
    """Square tags (AprilTag, ArUco) that stand in the scene, all of one size, each with a number of its own."""

    side_m: Annotated[float, Range(above=0, most=100)]
    """side of a tag, in metres"""
    dictionary: str = "DICT_APRILTAG_36h11"
    """OpenCV's name of the tags' dictionary"""

    def __post_init__(self) -> None:
        check_ranges(self)
