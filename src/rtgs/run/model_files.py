"""The models of a run: a PLY each, beside a JSON file with what the PLY cannot hold.

The files are in the given frame. `given_from_world` leads there from the world that the models are in (`Scene.given_from_world`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import RUN_AGAIN, RUN_MAKES_IT, read_record, write_json
from rtgs.images.pictures import save_tiff
from rtgs.io.exports.gaussian_ply import write_thermal_ply
from rtgs.io.image_files import read_counts
from rtgs.io.ply import THERMAL_PROPERTIES, read_ply, read_thermal_ply, write_ply
from rtgs.maths.geometry import Sim3
from rtgs.models import GaussianTemperatures, RgbModel, SensorModel, ThermalModel
from rtgs.records.decision import Decision
from rtgs.records.radiometry import LinearRange, PlanckRange
from rtgs.renderer import RenderSettings

T = TypeVar("T")


@dataclass(frozen=True)
class RgbFile:
    """`rgb.json`; the fields are `RgbModel`'s."""

    background: Sequence[float]
    settings: RenderSettings
    history: Mapping[str, Sequence[float]]
    decisions: tuple[Decision, ...] = ()


@dataclass(frozen=True)
class ThermalFile:
    """`thermal.json` and `thermal_naive.json`; the fields are those of `ThermalModel` and its `SensorModel`; `pattern` names a TIFF."""

    background: Sequence[float]
    settings: RenderSettings
    history: Mapping[str, Sequence[float]]
    range: LinearRange
    color_range: LinearRange | PlanckRange
    sfm_per_metre: float
    drift: Mapping[str, tuple[float, float]]
    pattern: str | None = None
    decisions: tuple[Decision, ...] = ()


def write_rgb(run: Path, model: RgbModel, given_from_world: Sim3) -> None:
    """Write `rgb.ply` and `rgb.json`."""
    write_ply(run / "rgb.ply", model.gaussians, given_from_world=given_from_world, background=model.background.tolist())
    settings = _in_unit(model.settings, given_from_world.factor)
    write_json(run / "rgb.json", RgbFile(model.background.tolist(), settings, model.history, model.decisions))


def read_rgb(run: Path, given_from_world: Sim3) -> RgbModel:
    """Read what `write_rgb` wrote.

    Raises:
        RtgsError: a file is missing or damaged.
    """
    file = read_record(RgbFile, run / "rgb.json")
    gaussians, settings = (
        _read_ply(read_ply, run / "rgb.ply", given_from_world),
        _in_unit(file.settings, 1.0 / given_from_world.factor),
    )
    if gaussians.channels != 3:
        raise RtgsError(f"{run / 'rgb.ply'}: is a thermal model of one channel. {RUN_AGAIN}")
    return RgbModel(gaussians, _background(run / "rgb.json", file.background, 3), settings, file.history, file.decisions)


def write_thermal(run: Path, model: ThermalModel, name: str, given_from_world: Sim3) -> None:
    """Write `NAME.ply`, `NAME.json` and, where the sensor has a pattern, `NAME_pattern.tiff`."""
    write_thermal_ply(run / f"{name}.ply", model, given_from_world)
    pattern = None
    if model.sensor.pattern is not None:
        pattern = f"{name}_pattern.tiff"
        save_tiff(run / pattern, model.sensor.pattern)
    write_json(
        run / f"{name}.json",
        ThermalFile(
            model.background.tolist(),
            _in_unit(model.settings, given_from_world.factor),
            model.history,
            model.range,
            model.color_range,
            model.sfm_per_metre,
            model.sensor.drift,
            pattern,
            model.decisions,
        ),
    )


def read_thermal(run: Path, name: str, given_from_world: Sim3) -> ThermalModel:
    """Read what `write_thermal` wrote.

    Raises:
        RtgsError: a file is missing or damaged, or an older version wrote it.
    """
    file = read_record(ThermalFile, run / f"{name}.json")
    ply = _read_ply(read_thermal_ply, run / f"{name}.ply", given_from_world)
    found = [ply.properties[name] for name in THERMAL_PROPERTIES if name in ply.properties]
    return ThermalModel(
        gaussians=ply.gaussians,
        background=_background(run / f"{name}.json", file.background, 1),
        unit="counts" if ply.celsius_range is None else "°C",
        range=file.range,
        color_range=file.color_range,
        settings=_in_unit(file.settings, 1.0 / given_from_world.factor),
        sfm_per_metre=file.sfm_per_metre,
        history=file.history,
        sensor=SensorModel(file.drift, _pattern(run, name, file.pattern)),
        temperatures=GaussianTemperatures(*found) if len(found) == len(THERMAL_PROPERTIES) else None,
        decisions=file.decisions,
    )


def _read_ply(read: Callable[[Path, Sim3], T], path: Path, given_from_world: Sim3) -> T:
    """A PLY of a run; errors say how to get it back."""
    if not path.exists():
        raise RtgsError(f"{path}: no such file. {RUN_MAKES_IT}")
    try:
        return read(path, given_from_world)
    except RtgsError as error:
        raise RtgsError(f"{str(error).removesuffix('.')}. {RUN_AGAIN}") from error


def _in_unit(settings: RenderSettings, factor: float) -> RenderSettings:
    """The settings in a unit `factor` times smaller."""
    return replace(settings, near_plane=settings.near_plane * factor)


def _background(path: Path, values: Sequence[float], channels: int) -> torch.Tensor:
    if len(values) != channels:
        raise RtgsError(f"{path}: background has {len(values)} numbers of {channels}. {RUN_AGAIN}")
    return torch.tensor(values, dtype=torch.float32)


def _pattern(run: Path, name: str, pattern: str | None) -> NDArray[np.float32] | None:
    if pattern is None:
        return None
    if pattern != f"{name}_pattern.tiff":
        raise RtgsError(f"{run / name}.json: pattern is {pattern!r:.100}, and {name}_pattern.tiff is the one. {RUN_AGAIN}")
    try:
        return read_counts(run / pattern).astype(np.float32)
    except RtgsError as error:
        raise RtgsError(
            f"{run / pattern}: the pattern of the sensor cannot be read. Remove it and {name}.json, and run again."
        ) from error
