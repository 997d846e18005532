"""Places on the Earth (WGS 84): latitude, longitude and height, and metres to the east, north and up of an origin.

A place is `[..., 3]`: latitude and longitude in degrees, height over the ellipsoid in metres. All is float64, since a degree is 111 km.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

_AXIS_M = 6_378_137.0  # WGS 84
_FLATTENING = 1 / 298.257223563
_ECCENTRICITY2 = _FLATTENING * (2 - _FLATTENING)
_ROUNDS = 6  # of a fixed-point iteration that gains three digits in each

Array = NDArray[np.float64]


def enu_from_places(places: ArrayLike, origin: ArrayLike) -> Array:
    """Metres to the east, north and up of the place `origin` `[3]`: `[..., 3]`."""
    origin = np.asarray(origin, dtype=np.float64)
    return np.asarray((_earth_from_places(np.asarray(places, dtype=np.float64)) - _earth_from_places(origin)) @ _axes(origin))


def places_from_enu(enu: ArrayLike, origin: ArrayLike) -> Array:
    """The inverse of `enu_from_places`."""
    origin = np.asarray(origin, dtype=np.float64)
    return _places_from_earth(np.asarray(enu, dtype=np.float64) @ _axes(origin).T + _earth_from_places(origin))


def _axes(origin: Array) -> Array:
    """`[3, 3]`, columns: east, north and up at the origin, in Earth-centred axes."""
    (sin_lat, sin_lon), (cos_lat, cos_lon) = np.sin(np.radians(origin[:2])), np.cos(np.radians(origin[:2]))
    east = np.array([-sin_lon, cos_lon, 0.0])
    up = np.array([cos_lat * cos_lon, cos_lat * sin_lon, sin_lat])
    return np.stack([east, np.cross(up, east), up], axis=1)


def _earth_from_places(places: Array) -> Array:
    latitude, longitude, height = np.radians(places[..., 0]), np.radians(places[..., 1]), places[..., 2]
    normal = _AXIS_M / np.sqrt(1 - _ECCENTRICITY2 * np.sin(latitude) ** 2)
    across = (normal + height) * np.cos(latitude)
    along_axis = (normal * (1 - _ECCENTRICITY2) + height) * np.sin(latitude)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), along_axis], axis=-1)


def _places_from_earth(points: Array) -> Array:
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    across = np.hypot(x, y)
    latitude = np.arctan2(z, across * (1 - _ECCENTRICITY2))
    for _ in range(_ROUNDS):
        normal = _AXIS_M / np.sqrt(1 - _ECCENTRICITY2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + _ECCENTRICITY2 * normal * np.sin(latitude), across)
    normal = _AXIS_M / np.sqrt(1 - _ECCENTRICITY2 * np.sin(latitude) ** 2)
    height = across * np.cos(latitude) + z * np.sin(latitude) - _AXIS_M**2 / normal
    return np.stack([np.degrees(latitude), np.degrees(np.arctan2(y, x)), height], axis=-1)
