"""`rig.json`: both cameras, the transform between them, and the thermal camera's radiometry."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import read_json, write_json
from rtgs.io.image_files import ImageHeader
from rtgs.io.rgb_start import completed_rgb
from rtgs.io.rig_start import FIELDS as RIG_FIELDS
from rtgs.io.rig_start import completed_thermal, is_to_be_found, rig_start
from rtgs.maths.geometry import SE3, is_rotation, nearest_rotation
from rtgs.records.camera import DISTORTION_OF_MODEL, Camera
from rtgs.records.radiometry import (
    CENTIKELVIN,
    Atmosphere,
    CountsToCelsius,
    ObjectParameters,
    PlanckCalibration,
    PlanckRadiometry,
    Radiometry,
    RelativeCounts,
)
from rtgs.records.rgb_camera import RgbStart
from rtgs.records.rig import CalibrationStd, Rig

MISSING = (
    "It describes both cameras. Where they are not calibrated, the thermal camera's size and field of view are enough: "
    '{"thermal": {"width": 640, "height": 512, "fov_deg": 45}}, with the numbers of its data sheet.'
)
"""What to do about a capture without `rig.json`."""

_SIZE_AND_PINHOLE = ("width", "height", "fl_x", "fl_y", "cx", "cy")
_LENS_TERMS = ("k1", "k2", "k3", "k4", "p1", "p2")
_LINEAR = ("celsius_per_count", "celsius_offset")
_RADIOMETRY = (*_LINEAR, "unit", "planck", "object")
_PLANCK = ("r1", "r2", "b", "f", "o")
_ATMOSPHERE = tuple(field.name for field in fields(Atmosphere))
_OBJECT = tuple(field.name for field in fields(ObjectParameters))
_STD = ("baseline_length", "baseline_direction", "rotation_deg", "thermal_focal")
_LONG_BASELINE_M = 2.0
_POWER_OF_TERM = {"k1": 2, "k2": 4, "k3": 6, "k4": 8, "p1": 1, "p2": 1}
_MOST_DISTORTION = 1000.0  # far more than the widest lenses have
_FOCAL_OF_SIDE = (0.02, 1000.0)  # of the longer side: fields of view of 176° and of 0.06°


@dataclass(frozen=True, eq=False)
class RigFile:
    """What `rig.json` says.

    Attributes:
        rig: cameras with their lenses; translation in metres.
        radiometry: what counts mean.
        rgb_start: what of the RGB camera is to be found; None where the file gives all of it.
        warnings: fields that were not understood, an implausible baseline.
    """

    rig: Rig
    radiometry: Radiometry
    warnings: tuple[str, ...] = ()
    rgb_start: RgbStart | None = None


def read_rig(path: Path, photograph: Callable[[], ImageHeader] | None = None) -> RigFile:
    """Read and check `rig.json`.

    Args:
        photograph: gives the header of an RGB file, from which fields of `rgb` that are left out are filled in; None: none may be.

    Raises:
        RtgsError: the file is missing or isn't JSON; a field is missing or has a wrong value; the transform isn't rigid; the
            baseline is zero.
    """
    data = read_json_object(path, missing=MISSING)
    warnings: list[str] = []
    rgb_start = None
    if photograph is not None and isinstance(data.get("rgb", {}), dict):
        data["rgb"], rgb_start = completed_rgb(path, data.get("rgb", {}), photograph)
    rgb = camera_from_json(path, "rgb", _member(path, data, "rgb"), warnings)
    thermal_data, start = _member(path, data, "thermal"), None
    to_be_found = is_to_be_found(path, data)
    if to_be_found:
        thermal_data = completed_thermal(path, thermal_data)
    thermal = camera_from_json(path, "thermal", thermal_data, warnings, more_fields=_RADIOMETRY)
    radiometry = _radiometry(path, thermal_data, warnings)
    if to_be_found:
        rgb_from_thermal, start = rig_start(path, data, lambda: _rig_transform(path, data, rough=True))
    else:
        rgb_from_thermal = _rig_transform(path, data)
    unknown = sorted(set(data) - {"rgb", "thermal", "uncertainty", *RIG_FIELDS})
    if unknown:
        warnings.append(f"{path.name}: {', '.join(unknown)} is not a known field and was ignored.")
    std = _calibration_std(path, data, warnings)
    if start is not None and std is not None:  # the rest of it belongs to a calibrated transform
        std = CalibrationStd(baseline_length=std.baseline_length)
    rig = Rig(rgb, thermal, rgb_from_thermal, std, start=start)
    if rig.baseline_m > _LONG_BASELINE_M:
        warnings.append(
            f"{path.name}: the baseline is {rig.baseline_m:g} m. Translations are in metres; is this one in millimetres?"
        )
    return RigFile(rig, radiometry, tuple(warnings), rgb_start)


def write_rig(path: Path, rig: Rig, radiometry: Radiometry) -> None:
    """Write `rig.json` so that `read_rig` gives the same records."""
    write_json(path, rig_to_json(rig, radiometry))


def rig_to_json(rig: Rig, radiometry: Radiometry) -> dict[str, Any]:
    """The content of `rig.json`."""
    thermal = camera_to_json(rig.thermal) | radiometry_to_json(radiometry)
    data = {"rgb": camera_to_json(rig.rgb), "thermal": thermal, "rgb_from_thermal": rig.rgb_from_thermal.matrix().tolist()}
    if rig.calibration_std is not None:
        values = asdict(rig.calibration_std)
        data["uncertainty"] = {"rotation_deg": math.degrees(values.pop("rotation_rad"))} | values
    return data


def _calibration_std(path: Path, data: Mapping[str, Any], warnings: list[str]) -> CalibrationStd | None:
    if "uncertainty" not in data:
        return None
    given = data["uncertainty"]
    if not isinstance(given, dict):
        raise RtgsError(f"{path}: uncertainty is not an object {{…}}; its fields are {', '.join(_STD)}.")
    unknown = sorted(set(given) - set(_STD))
    if unknown:
        warnings.append(f"{path.name}: uncertainty.{', uncertainty.'.join(unknown)} is not a known field and was ignored.")
    values = {name: finite_number(path, f"uncertainty.{name}", given, name) if name in given else 0.0 for name in _STD}
    for name, value in values.items():
        if value < 0:
            raise RtgsError(f"{path}: uncertainty.{name} is {value:g}; a standard deviation is 0 or above.")
    return CalibrationStd(rotation_rad=math.radians(values.pop("rotation_deg")), **values)


def read_json_object(path: Path, *, missing: str, remedy: str = "Correct it, or write it again.") -> dict[str, Any]:
    """The JSON object in a file; `missing` and `remedy` are those of `read_json`.

    Raises:
        RtgsError: as `read_json`, or not an object.
    """
    data = read_json(path, missing=missing, remedy=remedy)
    if not isinstance(data, dict):
        raise RtgsError(f"{path}: holds {type(data).__name__} where a JSON object {{…}} is expected.")
    return data


def camera_from_json(
    path: Path, where: str, data: Mapping[str, Any], warnings: list[str], *, more_fields: tuple[str, ...] = ()
) -> Camera:
    """A camera from its JSON fields; `where` prefixes their names in messages, unknown ones are added to `warnings`.

    Raises:
        RtgsError: unknown model, missing field, or a value that isn't a finite number of the right sign.
    """
    model = data.get("model")
    if model is None:
        raise RtgsError(f"{path}: {where}.model is missing. It is one of {', '.join(DISTORTION_OF_MODEL)}.")
    if not isinstance(model, str) or model not in DISTORTION_OF_MODEL:
        raise RtgsError(
            f"{path}: {where}.model is {model!r:.100}, which is not known. It is one of {', '.join(DISTORTION_OF_MODEL)}."
        )
    terms = DISTORTION_OF_MODEL[model]
    values = {name: finite_number(path, f"{where}.{name}", data, name) for name in _SIZE_AND_PINHOLE}
    for name in terms:
        if name not in data:
            raise RtgsError(
                f"{path}: {where}.{name} is missing. {model} has the terms {', '.join(terms)}; write 0 for one that is not used."
            )
        values[name] = finite_number(path, f"{where}.{name}", data, name)
    for name in ("width", "height"):
        if values[name] != int(values[name]) or values[name] <= 0:
            raise RtgsError(f"{path}: {where}.{name} is {values[name]:g}; it is a number of pixels, a whole number above 0.")
    for name in ("fl_x", "fl_y"):
        if values[name] <= 0:
            raise RtgsError(f"{path}: {where}.{name} is {values[name]:g}; a focal length is above 0 pixels.")
    if model.startswith("SIMPLE") and not math.isclose(values["fl_x"], values["fl_y"], rel_tol=1e-9):
        raise RtgsError(f"{path}: {where}.fl_x and fl_y differ, and {model} has one focal length. Use {model[7:]} instead.")
    for name in _LENS_TERMS:
        if name not in terms and data.get(name, 0) != 0:
            raise RtgsError(f"{path}: {where}.{name} is given, but {model} has no such term. {_term_remedy(model, name)}")
    unknown = sorted(set(data) - {"model", *_SIZE_AND_PINHOLE, *_LENS_TERMS, *more_fields})
    if unknown:
        warnings.append(f"{path.name}: {', '.join(f'{where}.{u}' for u in unknown)} is not a known field and was ignored.")
    width, height = int(values.pop("width")), int(values.pop("height"))
    camera = Camera(model=model, width=width, height=height, **values)
    wrong = absurd_intrinsics(camera)
    if wrong:
        raise RtgsError(f"{path}: {where}.{wrong}")
    return camera


def _term_remedy(model: str, name: str) -> str:
    """What to do with a lens term that a model lacks. A fisheye's terms have the names of others and another meaning."""
    fisheye = model == "OPENCV_FISHEYE"
    fitting = [m for m, terms in DISTORTION_OF_MODEL.items() if name in terms and (m == "OPENCV_FISHEYE") == fisheye]
    if fitting:
        return f"Models that have: {', '.join(fitting)}."
    if fisheye:
        return "A fisheye calibration has k1 to k4 alone; p1 and p2 are those of OPENCV."
    return (
        f"No model of a lens that is no fisheye has it, and {name} of OPENCV_FISHEYE is another quantity. Calibrate again with {name} "
        "fixed at 0 (cv2.CALIB_FIX_K3), or undistort the images."
    )


def absurd_intrinsics(camera: Camera) -> str | None:
    """What no camera has, as the end of a message that begins with the field's place; None for a possible camera."""
    longer = max(camera.width, camera.height)
    for name in ("fl_x", "fl_y"):
        value = getattr(camera, name)
        if not _FOCAL_OF_SIDE[0] * longer <= value <= _FOCAL_OF_SIDE[1] * longer:
            return (
                f"{name} is {value:g} pixels, for an image of {camera.width}×{camera.height}; it is between {_FOCAL_OF_SIDE[0]:g} and "
                f"{_FOCAL_OF_SIDE[1]:g} times the longer side. Is it in millimetres?"
            )
    for name, size in (("cx", camera.width), ("cy", camera.height)):
        value = getattr(camera, name)
        if not -size <= value <= 2 * size:
            return (
                f"{name} is {value:g} pixels, more than the image's size outside of an image of {camera.width}×{camera.height}. Is it of "
                "another image size?"
            )
    x, y = max(camera.cx, camera.width - camera.cx) / camera.fl_x, max(camera.cy, camera.height - camera.cy) / camera.fl_y
    corner = math.hypot(x, y)  # tangent of its angle to the optical axis, in which lens terms are polynomials
    corner = math.atan(corner) if camera.model == "OPENCV_FISHEYE" else corner  # there it is the angle itself
    for name, power in _POWER_OF_TERM.items():
        value = getattr(camera, name)
        if abs(value) * corner**power > _MOST_DISTORTION:
            return (
                f"{name} is {value:g}; with it the lens would move a corner of the image {_MOST_DISTORTION:g} times as far as it is from "
                "the middle. Calibrate again."
            )
    return None


def finite_number(path: Path, field: str, data: Mapping[str, Any], key: str) -> float:
    """`data[key]` as a finite float; `field` is its name in messages.

    Raises:
        RtgsError: missing, not a number, NaN or infinite.
    """
    if key not in data:
        raise RtgsError(f"{path}: {field} is missing.")
    value = data[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise RtgsError(f"{path}: {field} is {value!r:.100}; a finite number is expected.")
    return float(value)


def rigid_from_json(path: Path, field: str, value: Any) -> SE3:
    """A rigid transform from nested lists, 4×4, its rotation taken to the nearest orthonormal one.

    Raises:
        RtgsError: wrong shape, not finite, bottom row not 0 0 0 1, or no rotation.
    """
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4):
        raise RtgsError(f"{path}: {field} is not a 4×4 matrix of numbers (four rows of four).")
    if not np.isfinite(matrix).all():
        raise RtgsError(f"{path}: {field} holds NaN or infinity.")
    if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-9):
        raise RtgsError(
            f"{path}: the bottom row of {field} is {matrix[3].tolist()}, not [0, 0, 0, 1]. Is the matrix transposed? "
            "The translation belongs in the last column."
        )
    if not is_rotation(matrix[:3, :3]):
        raise RtgsError(
            f"{path}: the upper left 3×3 of {field} is no rotation (orthonormal, determinant +1; here determinant "
            f"{np.linalg.det(matrix[:3, :3]):.4g}). Axes are x right, y down, z forward; no scale, no mirroring."
        )
    return SE3(nearest_rotation(matrix[:3, :3]), matrix[:3, 3].copy())


def _rig_transform(path: Path, data: Mapping[str, Any], *, rough: bool = False) -> SE3:
    given = [key for key in ("thermal_from_rgb", "rgb_from_thermal") if key in data]
    if len(given) != 1:
        said = "both are" if given else "neither is"
        raise RtgsError(f"{path}: exactly one of thermal_from_rgb and rgb_from_thermal is expected, and {said} given.")
    transform = rigid_from_json(path, given[0], data[given[0]])
    if not rough and np.linalg.norm(transform.translation) < 1e-9:
        raise RtgsError(
            f"{path}: the translation of {given[0]} is zero. Scale comes from the distance between the two cameras: "
            "give the baseline in metres."
        )
    return transform if given[0] == "rgb_from_thermal" else transform.inverse()


def without_radiometry(data: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """The content of `rig.json` in two parts: without the fields that give °C, and those fields alone."""
    thermal = data.get("thermal")
    if not isinstance(thermal, Mapping):
        return dict(data), {}
    cameras = {key: value for key, value in thermal.items() if key not in _RADIOMETRY}
    return {**data, "thermal": cameras}, {key: value for key, value in thermal.items() if key in _RADIOMETRY}


def _radiometry(path: Path, thermal: Mapping[str, Any], warnings: list[str]) -> Radiometry:
    given = [key for key in (*_LINEAR, "unit", "planck") if key in thermal]
    ways = [key for key in given if key != "celsius_offset" or "celsius_per_count" not in given]  # those two are one way
    if len(ways) > 1:
        raise RtgsError(f"{path}: thermal.{ways[1]} and thermal.{ways[0]} are both given, and each defines °C. Keep one.")
    if "object" in thermal and "planck" not in thermal:
        raise RtgsError(f"{path}: thermal.object needs thermal.planck: object parameters change a signal, not a temperature.")
    if not given:
        return RelativeCounts()
    if "planck" in thermal:
        return _planck(path, thermal, warnings)
    if "unit" in thermal:
        if thermal["unit"] != "centikelvin":
            raise RtgsError(
                f"{path}: thermal.unit is {thermal['unit']!r:.100}; 'centikelvin' is the only one. Otherwise give "
                "celsius_per_count and celsius_offset (1 and 0 for images in °C)."
            )
        return CENTIKELVIN
    radiometry = CountsToCelsius(*(finite_number(path, f"thermal.{key}", thermal, key) for key in _LINEAR))
    if radiometry.celsius_per_count <= 0:
        raise RtgsError(f"{path}: thermal.celsius_per_count is {radiometry.celsius_per_count:g}; it is above 0.")
    return radiometry


def _planck(path: Path, thermal: Mapping[str, Any], warnings: list[str]) -> PlanckRadiometry:
    def numbers(block: str, names: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict[str, float]:
        data = thermal.get(block)
        if not isinstance(data, dict):
            raise RtgsError(
                f"{path}: thermal.{block} is {'missing' if data is None else 'not an object {…}'}; it holds {', '.join(names)}."
            )
        unknown = sorted(set(data) - {*names, *optional})
        if unknown:
            said = ", ".join(f"thermal.{block}.{name}" for name in unknown)
            warnings.append(f"{path.name}: {said} is not a known field and was ignored.")
        wanted = (*names, *(name for name in optional if name in data))
        return {name: finite_number(path, f"thermal.{block}.{name}", data, name) for name in wanted}

    planck, parameters = numbers("planck", _PLANCK, _ATMOSPHERE), numbers("object", _OBJECT)
    atmosphere = Atmosphere(**{name: planck.pop(name) for name in _ATMOSPHERE if name in planck})
    try:
        return PlanckRadiometry(PlanckCalibration(**planck, atmosphere=atmosphere), ObjectParameters(**parameters))
    except RtgsError as error:
        raise RtgsError(f"{path}: thermal.{error}") from error


def radiometry_to_json(radiometry: Radiometry) -> dict[str, Any]:
    """The fields of `thermal` that give °C; none where counts are relative."""
    if isinstance(radiometry, RelativeCounts):
        return {}
    if isinstance(radiometry, CountsToCelsius):
        return asdict(radiometry)
    planck = asdict(radiometry.calibration)
    atmosphere = planck.pop("atmosphere")
    return {"planck": planck | atmosphere, "object": asdict(radiometry.parameters)}


def _member(path: Path, data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    if key not in data:
        raise RtgsError(f"{path}: {key} is missing; it holds that camera's model, size and intrinsics.")
    if not isinstance(data[key], dict):
        raise RtgsError(f"{path}: {key} is not an object {{…}} of camera fields.")
    return data[key]


def camera_to_json(camera: Camera) -> dict[str, Any]:
    """A camera's fields as `rig.json` has them."""
    names = ("model", *_SIZE_AND_PINHOLE, *DISTORTION_OF_MODEL[camera.model])
    return {name: getattr(camera, name) for name in names}
