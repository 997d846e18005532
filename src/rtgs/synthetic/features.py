"""Warm and cold features of surfaces that only the thermal camera sees: spots, lines, a rectangle.

A feature adds to the temperature of the surface that it lies on. It is evaluated where rays meet that surface, so that perspective and
occlusion are right.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.synthetic.model import Floats, Surface
from rtgs.synthetic.raycast import CompiledModel, Hits, render_values

FeatureKind = Literal["spot", "line", "rectangle"]
Vector = tuple[float, float, float]
_FACING = 0.3  # cosine between normals: the far side of a thin thing is another surface


@dataclass(frozen=True)
class ThermalFeature:
    """One feature, in metres and in the world of the truth. `ground_truth.json` has it under the names below.

    Attributes:
        kind: "spot": a Gaussian. "line": Gaussian across, of one temperature along. "rectangle": of one temperature, with sharp edges.
        position_m, normal: centre, and the surface's unit normal there.
        along: unit vector along the line, or along the rectangle's longer side.
        part: which part of the model it lies on.
        size_px: the width asked for, in thermal pixels at the median distance of the frames that see it.
        fwhm_m: full width at half maximum, of a spot; across a line; the shorter side of a rectangle.
        length_m: likewise along `along`. The ends of a line fade beyond it.
        area_m2: of the surface where at least half of the excess is.
        excess_c: temperature at the centre less that of the surroundings. sign: hot 1, cold −1.
        surroundings_c, peak_c: temperature at the centre without and with the feature.
        views: names of the frames whose thermal camera sees it whole.
    """

    kind: FeatureKind
    position_m: Vector
    normal: Vector
    along: Vector
    part: int
    size_px: float
    fwhm_m: float
    length_m: float
    area_m2: float
    excess_c: float
    sign: int
    surroundings_c: float
    peak_c: float
    views: tuple[str, ...]

    @property
    def across(self) -> Floats:
        """`[3]`: unit vector on the surface, at right angles to `along`."""
        return np.cross(self.normal, self.along)

    def excess_at(self, surface: Surface) -> Floats:
        """`[N]` °C that the feature adds at points of surfaces."""
        offset = surface.world - np.array(self.position_m)
        own = (surface.part == self.part) & (surface.normal @ np.array(self.normal) > _FACING)
        u, v, h = (offset @ np.asarray(axis) for axis in (self.along, self.across, self.normal))
        if self.kind == "rectangle":
            inside = (np.abs(u) <= self.length_m / 2) & (np.abs(v) <= self.fwhm_m / 2)
            return self.excess_c * (own & inside & (np.abs(h) < self.fwhm_m))
        beyond = np.maximum(np.abs(u) - self.length_m / 2, 0.0) if self.kind == "line" else u
        squared = (beyond**2 + v**2 + h**2) / self.fwhm_m**2
        return self.excess_c * own * np.exp(-4 * math.log(2) * squared)


def area_m2(kind: FeatureKind, fwhm_m: float, length_m: float) -> float:
    """Of the surface where at least half of a feature's excess is: a disk, a band with round ends, a rectangle."""
    disk = math.pi * fwhm_m**2 / 4
    return {"spot": disk, "line": length_m * fwhm_m + disk, "rectangle": length_m * fwhm_m}[kind]


def render_excess(
    model: CompiledModel, features: Sequence[ThermalFeature], camera: Camera, world_from_camera: SE3, supersampling: int = 2
) -> NDArray[np.float32]:
    """`[H, W]` float32: °C that features add to `render_thermal`."""

    def excess(hits: Hits) -> Floats:
        return np.sum([feature.excess_at(hits.surface) for feature in features], axis=0)

    return render_values(model, camera, world_from_camera, supersampling, excess, 0.0)
