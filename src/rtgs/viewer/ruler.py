"""Lengths, areas and heights from points of a scene, with the interval of the scale carried over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.text import first_upper
from rtgs.viewer.contents import Contents

Kind = Literal["distance", "polyline", "area", "height above a plane"]
KINDS: tuple[Kind, ...] = get_args(Kind)
FEWEST = {"distance": 2, "polyline": 2, "area": 3, "height above a plane": 4}
"""Points that each kind needs. The first three of a height make the plane, and the last one is measured."""


@dataclass(frozen=True)
class Measured:
    """A measured number.

    Attributes:
        value: in `unit`. low, high: 95 % interval from the scale's; None where it is not known.
        note: what should be known about it; may be empty.
    """

    kind: Kind
    value: float
    unit: str
    low: float | None = None
    high: float | None = None
    note: str = ""

    def __str__(self) -> str:
        text = f"{self.value:.4g} {self.unit}"
        if self.low is not None and self.high is not None:
            text += f" ({min(self.low, self.high):.4g} … {max(self.low, self.high):.4g}, 95 %)"
        return text


def measure(kind: Kind, points: NDArray[np.float64], contents: Contents) -> Measured:
    """A length, an area or a height.

    Args:
        points: `[N, 3]` in the world, in the order in which they were clicked.

    Raises:
        RtgsError: too few points for this kind, or three points of a plane on one line.
    """
    if len(points) < FEWEST[kind]:
        raise RtgsError(f"{kind}: {FEWEST[kind]} points are needed, and there are {len(points)}.")
    dimension = 2 if kind == "area" else 1
    value = _world_value(kind, np.asarray(points, np.float64)) / contents.world_per_unit**dimension
    unit = contents.length_unit if dimension == 1 else ("m²" if contents.metric else "SfM units²")
    scale = contents.scale
    if scale is None:
        return Measured(kind, value, unit, note="There is no scale yet, so this is not in metres.")
    if scale.no_metres:
        return Measured(kind, value, unit, note=first_upper(scale.no_metres))
    note = f"The scale is {'in doubt' if scale.status == 'ok' else scale.status}: {scale.doubt}" if scale.doubt else ""
    if scale.metres_ci95 is None:
        return Measured(kind, value, unit, note=note)
    low, high = (value * (contents.sfm_per_unit / end) ** dimension for end in reversed(scale.metres_ci95))
    return Measured(kind, value, unit, low, high, note)


def _world_value(kind: Kind, points: NDArray[np.float64]) -> float:
    """In world units, or in their squares."""
    if kind == "distance":
        return float(np.linalg.norm(points[-1] - points[0]))
    if kind == "polyline":
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    if kind == "area":  # Newell: half of the sum of cross products, exact for a plane polygon and its projection for another one
        around = points - points.mean(axis=0)
        return 0.5 * float(np.linalg.norm(np.cross(around, np.roll(around, -1, axis=0)).sum(axis=0)))
    normal = np.cross(points[1] - points[0], points[2] - points[0])
    sides = np.linalg.norm(points[1] - points[0]) * np.linalg.norm(points[2] - points[0])
    if not np.linalg.norm(normal) > 1e-3 * sides:
        raise RtgsError(f"{kind}: the first three points lie on one line. Choose points that span a plane.")
    return abs(float((points[-1] - points[0]) @ normal / np.linalg.norm(normal)))
