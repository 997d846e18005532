"""The world that is computed in: recentred and scaled, so that float32 suffices at any origin and in any unit.

The given frame is the one that structure from motion or the capture's poses gave. Poses in it may be far from its origin (UTM coordinates)
and in any unit (millimetres). The world has its origin amid the cameras and the cameras' spread as its unit. One similarity, in float64,
leads from one to the other.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from rtgs.maths.geometry import SE3, Sim3

FAR_ORIGIN = 100.0
"""Distance of the origin, in spreads of the cameras, from which on positions in float32 are off by more than 6e-6 of a spread."""

POSITION_STEP = 2.0**-18
"""Grid of `Scene.steady` for camera positions, in spreads of the cameras: 0.004 pixels at a focal length of 1000, one spread away."""

POINT_STEP = 2.0**-12
"""Likewise for sparse points: 0.25 pixels. Structure from motion is hardly as exact, and the first step of training moves as far."""


def given_from_world(given_from_rgb: Iterable[SE3]) -> Sim3:
    """The similarity for these cameras, `given_from_rgb` each. It does not turn.

    Its translation is the median of the camera positions, coordinate by coordinate, and its factor the median distance from there: a few
    cameras that were placed wrongly do not move them. Where most cameras stand in one place, the factor is the largest distance.
    """
    centres = np.stack([pose.translation for pose in given_from_rgb])
    middle = np.median(centres, axis=0)
    factor = spread(centres, middle)
    return Sim3(factor if factor > 0 else 1.0, np.eye(3), middle)


def is_far(frame_from_world: Sim3) -> bool:
    """Whether the frame is too far from its origin for float32."""
    return bool(np.abs(frame_from_world.translation).max() > FAR_ORIGIN * frame_from_world.factor)


def spread(centres: NDArray[np.float64], middle: NDArray[np.float64]) -> float:
    """Median distance of camera positions `[N, 3]` from their middle `[3]`, or the largest one where the median is 0."""
    distances = np.linalg.norm(centres - middle, axis=1)
    return float(np.median(distances)) or float(distances.max())


def rounding(centres: NDArray[np.float64]) -> float:
    """By how much positions `[N, 3]` may have been moved when they were rounded to the numbers that hold them.

    Positions that float32 holds exactly were float32 before: programs keep poses in float32, and write them in decimals.
    """
    single = centres.astype(np.float32)
    numbers = single if (single == centres).all() else centres
    return float(np.spacing(np.abs(numbers).max())) / 2


def on_grid(positions: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Positions `[..., 3]` rounded to whole steps."""
    return np.round(positions / step) * step


def power_of_two(length: float) -> float:
    """The power of two nearest to a length: the last digits of the length do not change it, nor do they change a grid made of it."""
    return 2.0 ** round(math.log2(length)) if length > 0 else 1.0
