"""The RGB camera where `rig.json` does not give all of it: what structure from motion starts from, and what it finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rtgs.records.camera import Camera

Unknown = Literal["focal", "distortion"]


@dataclass(frozen=True)
class RgbStart:
    """What of the RGB camera has to be found; the camera of `Capture.raw_rig` is where the search starts.

    Attributes:
        unknown: what is found, of "focal" and "distortion"; the rest is held.
        source: where the starting focal length is from, in words.
        trusted: whether that source is good to a few per cent, so that it can help to verify matches.
    """

    unknown: tuple[Unknown, ...]
    source: str
    trusted: bool


@dataclass(frozen=True)
class FoundIntrinsic:
    """One number of a camera, before and after: pixels for fl_x and fl_y; the lens's terms have no unit.

    Attributes:
        std: standard deviation, from the covariance of the bundle adjustment; None where it could not be had.
    """

    name: str
    assumed: float
    found: float
    std: float | None


@dataclass(frozen=True)
class FoundRgbCamera:
    """The RGB camera that structure from motion found, for the files as they are stored or turned upright.

    Attributes:
        camera: with its lens.
        source: where the starting focal length was from, in words.
        values: what was found, with what was assumed before.
    """

    camera: Camera
    source: str
    values: tuple[FoundIntrinsic, ...]
