"""A rig that `rig.json` does not give, or only roughly: where the search for it starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.io.rgb_start import focal_of_fov
from rtgs.maths.geometry import SE3
from rtgs.records.rig import RigStart

FIELDS = ("thermal_from_rgb", "rgb_from_thermal", "rough", "baseline_m")


def completed_thermal(path: Path, thermal: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of `thermal` with those filled in that may be left out where the rig is to be found.

    The focal length is `fov_deg`'s, or the one that is given for one of the axes, the principal point the middle of the image, the lens
    without distortion.

    Raises:
        RtgsError: neither a focal length nor `fov_deg`, both, or a wrong `fov_deg`.
    """
    data = dict(thermal)
    width, height = data.get("width"), data.get("height")
    if not all(isinstance(side, (int, float)) for side in (width, height)):
        return data  # refused with the other fields
    assert isinstance(width, (int, float)) and isinstance(height, (int, float))
    data.setdefault("model", "PINHOLE")
    if "cx" not in data and "cy" not in data:
        data |= {"cx": width / 2, "cy": height / 2}
    if "fov_deg" in data:
        focal = focal_of_fov(path, "thermal", data, width)
        data |= {"fl_x": focal, "fl_y": focal}
    elif "fl_x" not in data and "fl_y" not in data:
        raise RtgsError(
            f'{path}: thermal.fl_x is missing. Give the focal length in pixels, or "fov_deg", the horizontal field of view of the data '
            "sheet: the search starts from there."
        )
    else:
        given = data["fl_x" if "fl_x" in data else "fl_y"]
        data = {"fl_x": given, "fl_y": given} | data
    data.pop("fov_deg", None)
    return data


def is_to_be_found(path: Path, data: Mapping[str, Any]) -> bool:
    """Whether the rig is to be found: there is no transform, or it is marked as rough.

    Raises:
        RtgsError: `rough` is no truth value, or `baseline_m` stands beside a calibrated transform.
    """
    rough = data.get("rough", False)
    if not isinstance(rough, bool):
        raise RtgsError(f"{path}: rough is {rough!r:.100}; it is true where the transform is only a start, or left out.")
    given = [name for name in FIELDS[:2] if name in data]
    if rough and not given:
        raise RtgsError(f"{path}: rough is true, but neither {FIELDS[0]} nor {FIELDS[1]} is given. Give one, or leave rough out.")
    if given and not rough and "baseline_m" in data:
        raise RtgsError(
            f"{path}: baseline_m is given beside {given[0]}, whose translation has a length already. Leave one out, or mark the transform "
            'with "rough": true.'
        )
    return rough or not given


def rig_start(path: Path, data: Mapping[str, Any], read: Callable[[], SE3]) -> tuple[SE3, RigStart]:
    """Where the search starts: the rotation that is given, or both cameras looking the same way.

    The translation is of `baseline_m`'s length, or of length 1, to the right: no more is known of it.

    Args:
        read: gives the transform where there is one.

    Raises:
        RtgsError: `baseline_m` is no length, or the transform is none.
    """
    length = data.get("baseline_m")
    if length is not None and (
        isinstance(length, bool) or not isinstance(length, (int, float)) or not math.isfinite(length) or length <= 0
    ):
        raise RtgsError(f"{path}: baseline_m is {length!r:.100}; it is the distance between the two lenses in metres, above 0.")
    rotation = read().rotation if any(name in data for name in FIELDS[:2]) else np.eye(3)
    known = None if length is None else float(length)
    thermal = data.get("thermal", {})
    pose = SE3(rotation, np.array([known or 1.0, 0.0, 0.0]))
    return pose, RigStart(baseline_m=known, centre_known="cx" in thermal and "cy" in thermal)
