"""Where on the Earth a scene is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import is_rotation
from rtgs.maths.wgs84 import places_from_enu

Vector = tuple[float, float, float]
AltitudeKind = Literal["ellipsoid", "sea level", "unknown"]


@dataclass(frozen=True)
class Georeference:
    """A similarity from the given frame, whose unit is the SfM unit, to metres east, north and up of an origin in WGS 84.

    x_enu = metres_per_sfm · rotation · x_given + translation_m. All numbers are float64.

    Attributes:
        latitude_deg, longitude_deg, altitude_m: the origin.
        altitude: what altitudes are measured from. A constant error of the altitude moves the scene up or down; no length changes.
        rotation: `[3, 3]`. translation_m: `[3]`.
        std_m: standard deviations of the scene's place to the east, north and up, as far as the photographs' positions tell.
    """

    JSON_PROPERTIES: ClassVar[tuple[str, ...]] = ("up",)

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    altitude: AltitudeKind
    metres_per_sfm: float
    rotation: tuple[Vector, Vector, Vector]
    translation_m: Vector
    std_m: Vector

    def __post_init__(self) -> None:
        if not (-90 <= self.latitude_deg <= 90 and -180 <= self.longitude_deg <= 180):
            raise RtgsError(f"latitude_deg and longitude_deg are {self.latitude_deg:g}, {self.longitude_deg:g}; no such place.")
        if not 0 < self.metres_per_sfm < math.inf:
            raise RtgsError(f"metres_per_sfm is {self.metres_per_sfm:g}; it is a finite number above 0.")
        if not is_rotation(self.rotation):
            raise RtgsError("rotation is none: orthonormal with determinant 1 is expected.")

    @property
    def up(self) -> Vector:
        """The direction of "up" in the given frame, of length 1."""
        return self.rotation[2]

    def in_unit(self, factor: float) -> Georeference:
        """The same for a frame in which all lengths are `factor` times larger: 1 / `metres_per_sfm` is then `factor` times as much."""
        return replace(self, metres_per_sfm=self.metres_per_sfm / factor)

    def enu(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Metres east, north and up of the origin, of points `[..., 3]` in the given frame."""
        turned = np.asarray(points, dtype=np.float64) @ np.array(self.rotation).T
        return np.asarray(self.metres_per_sfm * turned + np.array(self.translation_m))

    def places(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Latitude and longitude in degrees and altitude in metres, of points `[..., 3]` in the given frame."""
        return places_from_enu(self.enu(points), (self.latitude_deg, self.longitude_deg, self.altitude_m))
