"""GeoTIFF: pictures and maps with the place of their pixels, in metres.

Source: OGC 19-008r4.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, TiffImagePlugin

from rtgs.base.files import write_whole

_PIXEL_SCALE, _TIEPOINT, _KEYS, _NUMBERS, _TEXTS, _NO_DATA = 33550, 33922, 34735, 34736, 34737, 42113
_SHORT, _DOUBLE, _ASCII = 3, 12, 2
_USER_DEFINED, _METRE, _WGS84, _TRANSVERSE_MERCATOR = 32767, 9001, 4326, 1


@dataclass(frozen=True)
class RasterPlace:
    """Where the pixels are.

    Attributes:
        left, top: of the outer corner of the first pixel, metres; the second axis points up in the picture.
        pixel_m: width and height of a pixel.
        frame: what the coordinates are, in words.
        latitude_deg, longitude_deg: of the coordinates' origin on WGS 84, where it is known: then they are metres east and north.
    """

    left: float
    top: float
    pixel_m: float
    frame: str
    latitude_deg: float | None = None
    longitude_deg: float | None = None


def write_geotiff(path: Path, values: NDArray, place: RasterPlace) -> None:
    """Write a float32 map `[H, W]`, NaN where nothing is known, or a uint8 picture `[H, W, 3 or 4]`; whole or not at all."""
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    _set(tags, _PIXEL_SCALE, _DOUBLE, (place.pixel_m, place.pixel_m, 0.0))
    _set(tags, _TIEPOINT, _DOUBLE, (0.0, 0.0, 0.0, place.left, place.top, 0.0))
    text = place.frame.encode("ascii", "replace").decode() + "|"
    numbers: tuple[float, ...] = ()
    keys = [(1024, 0, 1, 1), (1025, 0, 1, 1), (1026, _TEXTS, len(text), 0)]  # projected, pixels are areas, what it is in words
    keys += [(2048, 0, 1, _WGS84)] if place.latitude_deg is not None else []
    keys += [(3072, 0, 1, _USER_DEFINED)]
    if place.latitude_deg is not None and place.longitude_deg is not None:
        # Metres east and north of a place are Transverse Mercator about it, to a millimetre within kilometres.
        keys += [(3074, 0, 1, _USER_DEFINED), (3075, 0, 1, _TRANSVERSE_MERCATOR)]
    keys += [(3076, 0, 1, _METRE)]
    if place.latitude_deg is not None and place.longitude_deg is not None:
        numbers = (place.longitude_deg, place.latitude_deg, 0.0, 0.0, 1.0)
        keys += [(key, _NUMBERS, 1, i) for i, key in enumerate((3080, 3081, 3082, 3083, 3092))]
    _set(tags, _KEYS, _SHORT, (1, 1, 0, len(keys), *(number for key in keys for number in key)))
    if numbers:
        _set(tags, _NUMBERS, _DOUBLE, numbers)
    _set(tags, _TEXTS, _ASCII, text)
    if values.dtype == np.float32:
        _set(tags, _NO_DATA, _ASCII, "nan")
    buffer = io.BytesIO()
    Image.fromarray(values).save(buffer, format="TIFF", tiffinfo=tags, compression="tiff_deflate")
    with write_whole(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def _set(tags: TiffImagePlugin.ImageFileDirectory_v2, tag: int, kind: int, value: tuple[float, ...] | str) -> None:
    tags.tagtype[tag] = kind
    tags[tag] = value
