"""The table of export formats: what each writes, holds and cannot hold."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.config import ExportFormat, ThermalColours
from rtgs.images.pictures import BACKGROUND, save_png, with_colour_bar
from rtgs.io.exports.compressed_ply import write_compressed_ply
from rtgs.io.exports.frames import Axes, FileFrame
from rtgs.io.exports.gaussian_ply import write_coloured_ply, write_rgb_ply, write_thermal_ply
from rtgs.io.exports.glb import write_glb
from rtgs.io.exports.orthophoto import write_orthophoto
from rtgs.io.exports.photographs import write_colmap, write_nerfstudio
from rtgs.io.exports.point_files import check_las, write_las, write_points_ply
from rtgs.io.exports.spz import write_spz
from rtgs.io.exports.subject import Splats, Subject, coloured, rgb_splats, thermal_splats
from rtgs.io.exports.surface import pixel_size, surface_points
from rtgs.io.exports.usd import check_usd, write_usd
from rtgs.records.radiometry import LinearRange

Writer: TypeAlias = Callable[[Subject, FileFrame, Path, Progress | None], list[Path]]


@dataclass(frozen=True)
class Format:
    """A format.

    Attributes:
        write: writes into a folder and returns what it wrote.
        axes: which way is up in such a file, unless the frame is that of the poses.
        program_decides: whether programs differ about that, so that `--program` may choose other axes.
        any_origin: whether positions are held exactly at any distance from the origin; others have the 24 bits of a float.
        cannot_hold: what is lost, in a sentence, or "".
        check: raises `RtgsError` where a library is missing.
    """

    write: Writer
    axes: Axes
    program_decides: bool = True
    any_origin: bool = False
    cannot_hold: str = ""
    check: Callable[[], None] = lambda: None


def _ply(subject: Subject, frame: FileFrame, out: Path, progress: Progress | None) -> list[Path]:
    write_rgb_ply(out / "rgb.ply", subject.rgb, frame)
    write_thermal_ply(out / "thermal.ply", subject.thermal, frame)
    gaussians, legend = coloured(subject.thermal, "palette")
    write_coloured_ply(out / "thermal_palette.ply", gaussians, frame)
    names = ("rgb.ply", "thermal.ply", "thermal_palette.ply")
    return [*(out / name for name in names), _legend(out, legend, subject.thermal.unit, "palette")]


def _pair(suffix: str, write: Callable[[Path, Splats, FileFrame], None]) -> Writer:
    """A format of one file for each model, with the legend of the thermal one."""

    def both(subject: Subject, frame: FileFrame, out: Path, progress: Progress | None) -> list[Path]:
        colours = subject.settings.thermal_colours
        thermal = thermal_splats(subject.thermal, frame.from_world, colours)
        assert thermal.legend is not None
        write(out / f"rgb{suffix}", rgb_splats(subject.rgb, frame.from_world), frame)
        write(out / f"thermal{suffix}", thermal, frame)
        return [out / f"rgb{suffix}", out / f"thermal{suffix}", _legend(out, thermal.legend, thermal.unit, colours)]

    return both


def _glb(path: Path, splats: Splats, frame: FileFrame) -> None:
    extras: dict[str, object] = {"unit": frame.unit}
    if splats.legend is not None:
        extras |= {"temperatureUnit": splats.unit, "coloursFrom": splats.legend.lo, "coloursTo": splats.legend.hi}
    write_glb(path, splats, extras)


def _points(suffix: str) -> Writer:
    def write(subject: Subject, frame: FileFrame, out: Path, progress: Progress | None) -> list[Path]:
        path, unit = out / f"points{suffix}", subject.thermal.unit
        asked = subject.settings.spacing_m
        if asked is not None and frame.per_metre is None:
            raise RtgsError("--spacing-m is a length in metres, and nothing tells metres. Leave it out.")
        spacing = pixel_size(subject) if asked is None else asked * (frame.per_metre or 1.0) / frame.from_world.factor
        points = surface_points(subject, spacing, progress)
        if suffix == ".ply":
            write_points_ply(path, points, frame.of(points.xyz), unit)
        else:
            write_las(path, points, frame.of(points.xyz), unit, frame.place if frame.axes == "z-up" else None)
        return [path]

    return write


def _folder(name: str, write: Callable[[Path, Subject, FileFrame, Progress | None], None]) -> Writer:
    def into(subject: Subject, frame: FileFrame, out: Path, progress: Progress | None) -> list[Path]:
        write(out / name, subject, frame, progress)
        return [out / name]

    return into


def _orthophoto(subject: Subject, frame: FileFrame, out: Path, progress: Progress | None) -> list[Path]:
    return write_orthophoto(out / "orthophoto", subject, frame)


def _legend(out: Path, span: LinearRange, unit: str, colours: ThermalColours) -> Path:
    name = "inferno" if colours == "palette" else "gray"
    path = out / f"thermal_{colours}_legend.png"
    empty = np.full((400, 8, 3), BACKGROUND, np.uint8)
    save_png(path, with_colour_bar(empty, span.lo, span.hi, unit, name))
    return path


_COLOURS_ONLY = "numbers in °C; temperatures are colours, with a legend beside them (gray ones can be turned back)"
_BACKGROUND = "the colour behind the Gaussians"

_POINTS_ONLY = "Gaussians: these are points on the surface"

FORMATS: Mapping[ExportFormat, Format] = {
    "ply": Format(_ply, "y-down", any_origin=True),
    "compressed-ply": Format(
        _pair(".compressed.ply", lambda path, splats, _: write_compressed_ply(path, splats)),
        "y-down",
        cannot_hold=f"{_COLOURS_ONLY}; {_BACKGROUND}; the order of the Gaussians",
    ),
    "spz": Format(
        _pair(".spz", lambda path, splats, _: write_spz(path, splats)), "y-up", cannot_hold=f"{_COLOURS_ONLY}; {_BACKGROUND}"
    ),
    "glb": Format(_pair(".glb", _glb), "y-up", program_decides=False, cannot_hold=_BACKGROUND),
    "usd": Format(_pair(".usdc", write_usd), "y-up", program_decides=False, cannot_hold=_BACKGROUND, check=check_usd),
    "points-ply": Format(_points(".ply"), "z-up", any_origin=True, cannot_hold=_POINTS_ONLY),
    "points-las": Format(_points(".las"), "z-up", any_origin=True, cannot_hold=_POINTS_ONLY, check=check_las),
    "points-laz": Format(_points(".laz"), "z-up", any_origin=True, cannot_hold=_POINTS_ONLY, check=check_las),
    "colmap": Format(_folder("colmap", write_colmap), "y-down", any_origin=True, cannot_hold="Gaussians"),
    "nerfstudio": Format(_folder("nerfstudio", write_nerfstudio), "z-up", any_origin=True, cannot_hold="Gaussians and points"),
    "orthophoto": Format(
        _orthophoto, "z-up", program_decides=False, any_origin=True, cannot_hold="what is hidden from that side"
    ),
}
"""By the name that `--format` takes."""
