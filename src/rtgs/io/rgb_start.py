"""RGB intrinsics that `rig.json` leaves out: where structure from motion starts to look for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rtgs.base.errors import RtgsError
from rtgs.io.image_files import ImageHeader
from rtgs.records.camera import DISTORTION_OF_MODEL
from rtgs.records.rgb_camera import RgbStart, Unknown

DIAGONAL_35MM = math.hypot(36.0, 24.0)
DEFAULT_MODEL = "SIMPLE_RADIAL"  # one focal length and one lens term: what a few dozen photographs surely decide
_DEFAULT_FOCAL = 1.2  # of the longer side, as COLMAP starts where a file says nothing
_WIDEST_DEG = 170.0
_PINHOLE = ("model", "width", "height", "fl_x", "fl_y", "cx", "cy")
_LENS_TERMS = ("k1", "k2", "k3", "k4", "p1", "p2")


def focal_of_fov(path: Path, where: str, data: Mapping[str, Any], width: float) -> float:
    """The focal length in pixels of a horizontal field of view, `fov_deg`, over so many pixels.

    Raises:
        RtgsError: `fov_deg` is no number between 0 and 170, or a focal length is given beside it.
    """
    value = data["fov_deg"]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < _WIDEST_DEG:
        raise RtgsError(
            f"{path}: {where}.fov_deg is {value!r:.100}; it is the horizontal field of view, between 0 and {_WIDEST_DEG:g}°."
        )
    if "fl_x" in data or "fl_y" in data:
        raise RtgsError(
            f"{path}: {where}.fov_deg and {where}.fl_x are both given; give the focal length alone if it is calibrated."
        )
    return 0.5 * width / math.tan(math.radians(float(value)) / 2)


def completed_rgb(
    path: Path, rgb: Mapping[str, Any], photograph: Callable[[], ImageHeader]
) -> tuple[dict[str, Any], RgbStart | None]:
    """The fields of `rgb` with those filled in that may be left out, and what of them is to be found; None where all are given.

    Size and principal point are taken from the file: its size, and its middle. The focal length starts at `fov_deg`, at EXIF's 35 mm
    equivalent, or at 1.2 times the longer side. Lens terms start at zero. Whatever is given stays as it is.

    Args:
        path: `rig.json`, for messages.
        photograph: gives the header of an RGB file; asked only where something is left out.

    Raises:
        RtgsError: `fov_deg` is wrong.
    """
    data, unknown = dict(rgb), list[Unknown]()
    given = {*_PINHOLE, *_terms(data)} <= set(data)
    if given and "fov_deg" not in data:
        return data, None
    header = photograph()
    width, height = header.size()
    if "width" not in data and "height" not in data:
        data |= {"width": width, "height": height}
    if "cx" not in data and "cy" not in data:
        data |= {"cx": width / 2, "cy": height / 2}
    terms_given = [name for name in _LENS_TERMS if name in data]
    if "model" not in data and not terms_given:
        data["model"] = DEFAULT_MODEL
    terms = _terms(data)
    if terms and not terms_given:
        data |= dict.fromkeys(terms, 0.0)
        unknown.append("distortion")
    source, trusted = "rig.json", True
    if "fl_x" not in data and "fl_y" not in data:
        unknown.insert(0, "focal")
        if "fov_deg" in data:
            focal, source = focal_of_fov(path, "rgb", data, width), "the field of view in rig.json"
        elif header.equivalent_mm is not None:
            focal, source = header.equivalent_mm / DIAGONAL_35MM * math.hypot(width, height), "EXIF's 35 mm equivalent"
        else:
            focal, source, trusted = _DEFAULT_FOCAL * max(width, height), "a guess, 1.2 times the longer side", False
        data |= {"fl_x": focal, "fl_y": focal}
    elif "fov_deg" in data:
        focal_of_fov(path, "rgb", data, width)  # refuses
    data.pop("fov_deg", None)
    return data, RgbStart(tuple(unknown), source, trusted) if unknown else None


def _terms(data: Mapping[str, Any]) -> tuple[str, ...]:
    model = data.get("model")
    return DISTORTION_OF_MODEL.get(model, ()) if isinstance(model, str) else ()
