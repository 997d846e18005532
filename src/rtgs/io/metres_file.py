"""`metres.json` of a capture: distances that are known, and boards and tags of known size in the scene."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import read_record
from rtgs.config.calibration import BoardConfig
from rtgs.config.metres import TagsConfig

NAME = "metres.json"
USUAL_STD = 0.005
"""Standard deviation of a distance that states none, relative: a tape measure's."""

Pixel = tuple[float, float]


@dataclass(frozen=True)
class CameraDistance:
    """The distance between the RGB cameras of two frames.

    Attributes:
        frames: their names. metres: between the optical centres.
        std_m: standard deviation; None: `USUAL_STD` of the distance.
    """

    frames: tuple[str, str]
    metres: float
    std_m: float | None = None

    def __post_init__(self) -> None:
        _check_length(self.metres, self.std_m)
        if self.frames[0] == self.frames[1]:
            raise RtgsError(f"frames are {self.frames[0]!r} twice; a distance is between two frames.")


@dataclass(frozen=True)
class PointDistance:
    """The distance between two points of the scene, each picked in two RGB images or more.

    Attributes:
        first, second: frame name → pixel (x, y) in the RGB file, the centre of the first pixel at (0.5, 0.5).
        metres, std_m: as in `CameraDistance`.
        pick_px: standard deviation of a picked pixel, in each direction.
    """

    first: Mapping[str, Pixel]
    second: Mapping[str, Pixel]
    metres: float
    std_m: float | None = None
    pick_px: float = 1.0

    def __post_init__(self) -> None:
        _check_length(self.metres, self.std_m)
        if not 0 < self.pick_px < math.inf:
            raise RtgsError(f"pick_px is {self.pick_px:g}; it is a number of pixels above 0.")
        for name, picked in (("first", self.first), ("second", self.second)):
            if len(picked) < 2:
                raise RtgsError(f"{name} is picked in {len(picked)} images; depth needs two or more.")


@dataclass(frozen=True)
class MetresFile:
    """What `metres.json` says. All fields may be missing.

    Attributes:
        camera_distances, point_distances: known distances.
        board: a board that stands still in the scene, with the size of its squares.
        tags: tags that stand still in the scene.
    """

    camera_distances: tuple[CameraDistance, ...] = ()
    point_distances: tuple[PointDistance, ...] = ()
    board: BoardConfig | None = None
    tags: TagsConfig | None = None


def read_metres_file(root: Path) -> MetresFile:
    """`metres.json` of the capture at `root`; empty where there is none.

    Raises:
        RtgsError: it cannot be read, a field is not known, or a number is out of its range.
    """
    path = root / NAME
    remedy = "Correct it: the documents show its form under Formats."
    return read_record(MetresFile, path, remedy=remedy) if path.exists() else MetresFile()


def _check_length(metres: float, std_m: float | None) -> None:
    if not 0 < metres < 1e6:
        raise RtgsError(f"metres is {metres:g}; a distance is above 0.")
    if std_m is not None and not 0 < std_m < metres:
        raise RtgsError(f"std_m is {std_m:g} of {metres:g} m; a standard deviation is above 0 and below the distance.")
