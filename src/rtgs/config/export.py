"""Settings of the export: formats, the frame of the files, and what orthophotos and surface points look like."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import tyro

from rtgs.config.ranges import Range, check_ranges

ExportFormat: TypeAlias = Literal[
    "ply", "compressed-ply", "spz", "glb", "usd", "points-ply", "points-las", "points-laz", "colmap", "nerfstudio", "orthophoto"
]
ExportFrame: TypeAlias = Literal["metric", "sfm"]
Program: TypeAlias = Literal["supersplat", "spark", "niantic", "cloudcompare", "blender"]
ThermalColours: TypeAlias = Literal["palette", "gray"]
Plane: TypeAlias = Literal["top", "facade"]


@dataclass(frozen=True)
class ExportConfig:
    """What `rtgs export` writes, and in which frame."""

    formats: Annotated[tuple[ExportFormat, ...], tyro.conf.arg(name="format")] = ("ply",)
    """One format or several."""
    frame: ExportFrame = "metric"
    """"metric": metres, gravity along an axis. "sfm": frame and unit of the poses, as in the run folder."""
    program: Program | None = None
    """Who will open the files: decides which axis is up. Without it, what most programs expect of the format."""
    thermal_colours: ThermalColours = "palette"
    """Colours of thermal models for viewers. Gray is linear in temperature, so that it can be turned back into °C."""
    plane: Plane = "top"
    """Orthophoto: from above, or of the largest upright plane from its front."""
    normal: Annotated[tuple[float, float, float] | None, Range()] = None
    """Orthophoto: of the plane with this normal instead. It points to the viewer, with z up."""
    pixel_m: Annotated[float | None, Range(above=0)] = None
    """Orthophoto: size of a pixel in metres. Without it, a thermal pixel's."""
    spacing_m: Annotated[float | None, Range(above=0)] = None
    """Surface points: distance in metres. Without it, a thermal pixel's."""

    def __post_init__(self) -> None:
        check_ranges(self, "export")
