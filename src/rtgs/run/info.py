"""What a file or a folder is, in a few facts: `rtgs info`."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import read_json, read_record
from rtgs.evaluation.records import Evaluation
from rtgs.io.cameras.registry import MODULES, camera_format
from rtgs.io.capture import load_capture
from rtgs.io.colmap import read_sparse
from rtgs.io.image_files import read_counts, read_header
from rtgs.io.photograph_tags import read_photograph_tags
from rtgs.io.ply import check_length
from rtgs.io.rig import read_rig
from rtgs.records.camera import Camera
from rtgs.records.rig import Rig
from rtgs.run.config_file import is_run
from rtgs.run.folder import RunFolder
from rtgs.run.records import CaptureSummary
from rtgs.run.stages import not_made
from rtgs.scale import ScaleEstimate

Facts: TypeAlias = dict[str, Any]
_PICTURES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".rjpg")
_COLUMNS_SHOWN = 20


@dataclass(frozen=True)
class Kind:
    """A kind of file or folder.

    Attributes:
        name: for people.
        recognises: whether a path that exists is one, from names alone.
        facts: raises `RtgsError` where it is damaged.
    """

    name: str
    recognises: Callable[[Path], bool]
    facts: Callable[[Path], Facts]


def describe(path: Path) -> Facts:
    """The facts about a file or a folder, its kind first.

    Raises:
        RtgsError: there is nothing, or nothing that is known; or it is damaged.
    """
    if not path.exists():
        raise RtgsError(f"{path}: there is no such file or folder.")
    for kind in KINDS:
        if kind.recognises(path):
            return {"kind": kind.name, "path": str(path)} | kind.facts(path)
    known = ", ".join(dict.fromkeys(kind.name for kind in KINDS))
    raise RtgsError(f"{path}: is none of what rtgs knows: {known}.")


def _run(path: Path) -> Facts:
    folder = RunFolder(path)
    saved = folder.read_config()
    facts: Facts = {"capture": str(saved.capture), "version": saved.version}
    facts["stages done"] = [name for name, entry in folder.entries().items() if entry.fingerprint]
    facts["files missing"] = [file for name, files in not_made(path).items() if name in facts["stages done"] for file in files]
    facts["stages begun"] = [name for name, entry in folder.entries().items() if entry.begun]
    if (path / "capture_summary.json").exists():
        summary = CaptureSummary.read(path / "capture_summary.json")
        facts |= {"frames": summary.frames, "registered": summary.registered, "unit": summary.unit}
    for name in ("rgb.ply", "thermal.ply"):
        if (path / name).exists():
            facts[f"Gaussians in {name}"] = len(_ply_of(path / name)["vertex"].data)
    if (path / "scale.json").exists():
        facts |= _scale(path / "scale.json")
    if (path / "metrics.json").exists():
        facts |= _metrics(path / "metrics.json")
    return facts


def _capture(path: Path) -> Facts:
    capture = load_capture(path)
    poses = "none: structure from motion will run" if capture.poses is None else f"{len(capture.poses.world_from_rgb)} came along"
    return {
        "frames": len(capture.frames),
        "unit": capture.radiometry.unit,
        "rgb": _camera(capture.raw_rig.rgb),
        "thermal": _camera(capture.raw_rig.thermal),
        "baseline in metres": _baseline_m(capture.rig),
        "poses": poses,
        "warnings": list(capture.warnings),
    }


def _baseline_m(rig: Rig) -> float | None:
    """None where `rig.json` does not give it."""
    return rig.baseline_m if rig.start is None else rig.start.baseline_m


def _colmap(path: Path) -> Facts:
    camera, poses = read_sparse(path)
    points = 0 if poses.points is None else len(poses.points)
    return {"RGB images with poses": len(poses.world_from_rgb), "points": points, "rgb": _camera(camera)}


def _ply_of(path: Path) -> PlyData:
    try:
        check_length(path)
        return PlyData.read(str(path))
    except OSError as error:
        raise RtgsError(f"{path}: cannot be read ({error.strerror or error})") from error
    except RtgsError:
        raise
    except Exception as error:  # plyfile raises many kinds where a header says odd things
        raise RtgsError(f"{path}: not a whole PLY file ({error!s:.200})") from error


def _ply(path: Path) -> Facts:
    ply = _ply_of(path)
    facts: Facts = {element.name: len(element.data) for element in ply.elements}
    if "vertex" not in ply or not ply["vertex"].data.dtype.names:
        return facts
    data = ply["vertex"].data
    names = list(data.dtype.names)
    if {"f_dc_0", "opacity", "scale_0", "rot_0"} <= set(names):
        rest = sum(name.startswith("f_rest_") for name in names)
        facts |= {"holds": "Gaussians", "harmonics of degree": round((rest / 3 + 1) ** 0.5) - 1}
    elif "packed_position" in names:
        facts["holds"] = "Gaussians, compressed"
    facts["comments"] = list(ply.comments)
    facts["columns"] = [n for n in names if not n.startswith("f_rest_")][:_COLUMNS_SHOWN]
    for name in (*"xyz", "temperature", "temperature_std", "views"):
        if name in names and len(data) and data.dtype[name].kind != "O":  # a list
            facts[name] = _span(data[name])
    return facts


def _scale(path: Path) -> Facts:
    estimate = read_record(ScaleEstimate, path)
    facts: Facts = {} if estimate.metres_per_sfm is None else {"SfM units per metre": 1 / estimate.metres_per_sfm}
    facts["status"] = estimate.status
    if estimate.metres_ci95 is not None:
        facts["95 % interval"] = list(estimate.metres_ci95)
    if estimate.no_metres or estimate.reason:
        facts["reason"] = estimate.no_metres or estimate.reason
    return facts | {"metres per SfM unit": estimate.metres_per_sfm}


def _metrics(path: Path) -> Facts:
    found = read_record(Evaluation, path)
    return {
        f"{model} {name}": value
        for model, scores in found.models.items()
        for name in ("psnr", "ssim", "mae_c", "mae_counts")
        if (value := getattr(scores, name)) is not None
    }


def _rig(path: Path) -> Facts:
    found = read_rig(path)
    rig = found.rig
    return {
        "rgb": _camera(rig.rgb),
        "thermal": _camera(rig.thermal),
        "baseline in metres": _baseline_m(rig),
        "unit": found.radiometry.unit,
        "warnings": list(found.warnings),
    }


def _spots(path: Path) -> Facts:
    data = read_json(path)
    spots = data.get("spots") if isinstance(data, dict) else None
    if not isinstance(spots, list):
        raise RtgsError(f"{path}: holds no list of spots. `rtgs spots` writes it again.")
    return {"spots": len(spots), "criterion": data.get("criterion"), "unit": data.get("unit")}


def _transforms(path: Path) -> Facts:
    data = read_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("frames"), list):
        raise RtgsError(f"{path}: has no list of frames.")
    return {
        "frames": len(data["frames"]),
        "camera model": data.get("camera_model"),
        "width": data.get("w"),
        "height": data.get("h"),
    }


def _settings(path: Path) -> Facts:
    saved = RunFolder(path.parent).read_config()
    return {"capture": str(saved.capture), "version": saved.version, "settings of": [f.name for f in fields(saved.config)]}


def _stages(path: Path) -> Facts:
    entries = RunFolder(path.parent).entries()
    return {
        "stages done": [name for name, entry in entries.items() if entry.fingerprint],
        "stages begun": [name for name, entry in entries.items() if entry.begun],
    }


def _json(path: Path) -> Facts:
    data = read_json(path)
    return {"keys": list(data)} if isinstance(data, dict) else {"holds": type(data).__name__, "entries": len(data)}


def _picture(path: Path) -> Facts:
    header = read_header(path)
    width, height = header.stored_size
    facts: Facts = {
        "format": header.format,
        "width": width,
        "height": height,
        "bits of a number": header.bits,
        "mode": header.mode,
    }
    facts |= {"orientation": header.orientation} if header.orientation != 1 else {}
    maker = next((name for name in MODULES if header.format in ("JPEG", "MPO") and camera_format(name).recognises(path)), None)
    if maker is not None:
        shot = camera_format(maker).read(path)
        size = f"{shot.counts.shape[1]} × {shot.counts.shape[0]}"
        facts |= {"thermal data": f"{maker}, {size} pixels", "°C": _span(shot.radiometry.celsius(shot.counts))}
    elif header.mode.startswith(("I", "F")):
        facts["numbers"] = _span(read_counts(path))
    tags = read_photograph_tags(path)
    if tags.position is not None:
        place = tags.position
        facts |= {"latitude": place.latitude_deg, "longitude": place.longitude_deg, "altitude in metres": place.altitude_m}
    if tags.laser_m is not None:
        facts["laser range in metres"] = tags.laser_m
    return facts


def _camera(camera: Camera) -> str:
    return f"{camera.model} {camera.width} × {camera.height}, focal length {camera.fl_x:.1f} px"


def _span(values: NDArray[Any]) -> Mapping[str, float]:
    numbers = np.asarray(values, np.float64)
    known = numbers[np.isfinite(numbers)]
    if known.size == 0:
        return {"known": 0}
    return {"least": float(known.min()), "median": float(np.median(known)), "largest": float(known.max())}


def _named(*names: str) -> Callable[[Path], bool]:
    return lambda path: path.is_file() and path.name in names


def _ends(*suffixes: str) -> Callable[[Path], bool]:
    return lambda path: path.is_file() and path.suffix.lower() in suffixes


def _has(*names: str) -> Callable[[Path], bool]:
    return lambda path: path.is_dir() and any((path / name).exists() for name in names)


def _is_capture(path: Path) -> bool:
    """A folder of pictures in a run, `renders`, has subfolders of the same names."""
    return _has("rig.json", "rgb")(path) and not is_run(path.parent)


_OTHERS = {
    "capture_summary.json": "summary of a capture",
    "failures.json": "frames without a pose, with the reasons",
    "hashes.json": "content of a capture's files",
    "rgb.json": "RGB model, beside rgb.ply",
    "thermal.json": "thermal model, beside thermal.ply",
    "thermal_naive.json": "thermal model at scale 1, beside thermal_naive.ply",
    "world.json": "world of a run, in the frame of the poses",
    "georeference.json": "place on the Earth",
}
"""Other JSON files that rtgs writes."""

KINDS: Sequence[Kind] = (
    Kind("run folder", is_run, _run),
    Kind("COLMAP model", _has("cameras.bin", "cameras.txt"), _colmap),
    Kind("capture", _is_capture, _capture),
    Kind("scale", _named("scale.json"), _scale),
    Kind("scores", _named("metrics.json"), _metrics),
    Kind("rig", _named("rig.json"), _rig),
    Kind("list of spots", _named("spots.json"), _spots),
    Kind("poses of nerfstudio", _named("transforms.json", "transforms_thermal.json"), _transforms),
    Kind("settings of a run", _named("config.json"), _settings),
    Kind("stages of a run", _named("stages.json"), _stages),
    *(Kind(name, _named(file), _json) for file, name in _OTHERS.items()),
    Kind("JSON file", _ends(".json"), _json),
    Kind("PLY", _ends(".ply"), _ply),
    Kind("picture", _ends(*_PICTURES), _picture),
)
"""The first that recognises a path describes it."""


def lines(facts: Facts) -> list[str]:
    """The facts for a terminal, a line each; lists of sentences have a line for each."""
    found: list[str] = []
    for name, value in facts.items():
        if isinstance(value, list) and any(" " in str(v) for v in value):
            found += [f"{name}: {v}" for v in value]
        elif value not in (None, [], ()):
            found.append(f"{name}: {_text(value)}")
    return found


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return ", ".join(_text(v) for v in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    return str(value)


def as_json(facts: Facts) -> str:
    """The facts as one JSON object."""
    return json.dumps(facts, ensure_ascii=False, indent=1, allow_nan=False)
