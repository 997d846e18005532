"""What a photograph's tags say of where it was taken: EXIF's GPS, and the XMP of DJI with RTK and laser range finder.

Values that the camera itself marks as invalid are refused, with the reason. Nothing is decoded.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rtgs.io.image_files import opened
from rtgs.records.georeference import AltitudeKind

_GPS_IFD = 0x8825
_LATITUDE_REF, _LATITUDE, _LONGITUDE_REF, _LONGITUDE, _ALTITUDE_REF, _ALTITUDE, _STATUS, _HORIZONTAL_ERROR = (
    1,
    2,
    3,
    4,
    5,
    6,
    9,
    31,
)
_XMP_KEYS = ("xmp", "XML:com.adobe.xmp")  # as Pillow names it in JPEG and PNG
_TIFF_XMP = 700
_DJI = re.compile(rb'drone-dji:(\w+)\s*=\s*"([^"]*)"|<drone-dji:(\w+)>([^<]*)</drone-dji:')
_RTK_FAILED, _RTK_FLOAT, _RTK_FIXED = 0, range(32, 50), 50
_VERTICAL = 2.0  # standard deviation of GPS altitudes, in horizontal ones
_LASER_RANGE_M = (1.0, 3000.0)  # of DJI's range finders


@dataclass(frozen=True)
class PositionTag:
    """Where a photograph says that it was taken.

    Attributes:
        latitude_deg, longitude_deg, altitude_m: WGS 84; altitude None where it is not stated.
        altitude: what the altitude is measured from.
        std_m: standard deviations to the east, north and up, where the file states its accuracy.
        source: which tags, for people.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float | None
    altitude: AltitudeKind
    std_m: tuple[float, float, float] | None
    source: str


@dataclass(frozen=True)
class PhotographTags:
    """Tags of one photograph.

    Attributes:
        position: None where there is none that can be used. position_refused: why; empty where there are no tags at all.
        laser_m: distance that the range finder measured. laser_refused: why there is none although there are tags.
    """

    position: PositionTag | None = None
    position_refused: str = ""
    laser_m: float | None = None
    laser_refused: str = ""


def read_photograph_tags(path: Path) -> PhotographTags:
    """Position and laser range of a photograph. A tag that is damaged counts as absent.

    Raises:
        RtgsError: the file is no readable image.
    """
    with opened(path) as image:
        try:
            gps: Mapping[int, Any] = image.getexif().get_ifd(_GPS_IFD)
        except Exception:  # a damaged entry, of which Pillow raises many kinds: the image is good without it
            gps = {}
        found = next((image.info[key] for key in _XMP_KEYS if key in image.info), None) or _tiff_xmp(image)
    dji = _dji_tags(found.encode() if isinstance(found, str) else found)
    position, refused = _dji_position(dji) if _dji_has_position(dji) else _exif_position(gps)
    laser, laser_refused = _laser(dji)
    return PhotographTags(position, refused, laser, laser_refused)


def _tiff_xmp(image: Any) -> bytes | None:
    value = getattr(image, "tag_v2", {}).get(_TIFF_XMP)
    return value if isinstance(value, bytes) else None


def _dji_tags(xmp: object) -> dict[str, str]:
    if not isinstance(xmp, bytes):
        return {}
    pairs = [(m[1] or m[3], m[2] if m[1] else m[4]) for m in _DJI.finditer(xmp)]
    return {key.decode("ascii", "replace"): value.decode("utf-8", "replace").strip() for key, value in pairs}


def _dji_has_position(dji: Mapping[str, str]) -> bool:
    return "GpsLatitude" in dji and ("GpsLongitude" in dji or "GpsLongtitude" in dji)


def _dji_position(dji: Mapping[str, str]) -> tuple[PositionTag | None, str]:
    latitude, longitude = _number(dji.get("GpsLatitude")), _number(dji.get("GpsLongitude") or dji.get("GpsLongtitude"))
    if dji.get("GpsStatus", "Normal") == "Invalid":
        return None, "GpsStatus is Invalid"
    flag, std_m, source = _number(dji.get("RtkFlag")), None, "DJI GPS"
    if flag is not None and int(flag) != _RTK_FAILED:
        east, north, up = (_number(dji.get(f"RtkStd{name}")) for name in ("Lon", "Lat", "Hgt"))
        if east and north and up and min(east, north, up) > 0:
            std_m = (east, north, up)
        kind = "fixed" if flag == _RTK_FIXED else "float" if int(flag) in _RTK_FLOAT else "single point"
        source = f"DJI RTK, {kind}"
    altitude: AltitudeKind = "ellipsoid" if dji.get("AltitudeType") == "RtkAlt" else "unknown"
    return _checked(latitude, longitude, _number(dji.get("AbsoluteAltitude")), altitude, std_m, source)


def _exif_position(gps: Mapping[int, Any]) -> tuple[PositionTag | None, str]:
    if _LATITUDE not in gps or _LONGITUDE not in gps:
        return None, ""
    if str(gps.get(_STATUS, "A")).strip(" \0") == "V":
        return None, "the receiver had no fix (GPSStatus V)"
    latitude = _degrees(gps[_LATITUDE], gps.get(_LATITUDE_REF), "S")
    longitude = _degrees(gps[_LONGITUDE], gps.get(_LONGITUDE_REF), "W")
    altitude = _number(gps.get(_ALTITUDE))
    if altitude is not None and gps.get(_ALTITUDE_REF) in (1, b"\x01", "\x01"):
        altitude = -altitude
    error = _number(gps.get(_HORIZONTAL_ERROR))
    std_m = (error, error, _VERTICAL * error) if error is not None and error > 0 else None
    return _checked(latitude, longitude, altitude, "sea level", std_m, "EXIF GPS")


def _checked(
    latitude: float | None,
    longitude: float | None,
    altitude_m: float | None,
    altitude: AltitudeKind,
    std_m: tuple[float, float, float] | None,
    source: str,
) -> tuple[PositionTag | None, str]:
    if latitude is None or longitude is None or not (-90 <= latitude <= 90 and -180 <= longitude <= 180):
        return None, f"{source}: latitude and longitude are no place"
    if latitude == 0 and longitude == 0:
        return None, f"{source}: latitude and longitude are 0, as without a fix"
    return PositionTag(latitude, longitude, altitude_m, altitude, std_m, source), ""


def _laser(dji: Mapping[str, str]) -> tuple[float | None, str]:
    if "LRFTargetDistance" not in dji:
        return None, ""
    status, metres = dji.get("LRFStatus", "Normal"), _number(dji["LRFTargetDistance"])
    if status != "Normal":
        return None, f"LRFStatus is {status[:40]}"
    if metres is None or not _LASER_RANGE_M[0] <= metres <= _LASER_RANGE_M[1]:
        return None, f"LRFTargetDistance is {dji['LRFTargetDistance'][:40]}"
    return metres, ""


def _degrees(parts: Any, reference: Any, negative: str) -> float | None:
    """Degrees, minutes and seconds as one number."""
    try:
        degrees, minutes, seconds = (float(part) for part in parts)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    value = degrees + minutes / 60 + seconds / 3600
    return (-value if str(reference).strip(" \0").upper() == negative else value) if math.isfinite(value) else None


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None
