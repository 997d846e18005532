"""Settings of the paper's experiments: `rtgs experiment synthetic` and `rtgs experiment real`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, get_args

from rtgs.base.errors import RtgsError
from rtgs.config.ranges import Range, check_ranges
from rtgs.config.rgb import RgbConfig
from rtgs.config.synthetic import SCENES, SceneName
from rtgs.config.thermal import ThermalConfig

SyntheticTable = Literal["1", "2", "beyond", "ablation"]
SYNTHETIC_TABLES: tuple[SyntheticTable, ...] = get_args(SyntheticTable)


@dataclass(frozen=True)
class SyntheticExperimentConfig:
    """Settings of `rtgs experiment synthetic`."""

    table: Literal["1", "2", "beyond", "ablation", "all"] = "1"
    """"1": the paper's Table I, six scenes × five seeds; "2": its Table II, what goes wrong with images and calibration; "beyond": fewer
    frames, more noise, inverted contrast, low resolution, a scene that does not show its scale; "ablation": the search's defaults beside
    other values"""
    size: Annotated[int, Range(32, 10**5)] = 400
    """width and height of all images, in pixels"""
    frames: Annotated[int, Range(8, 10**5)] = 50
    """pairs a scene; every eighth is held out and not seen by any method"""
    scenes: tuple[SceneName, ...] = SCENES[:6]
    """which scenes"""
    seeds: Annotated[int, Range(1, 10**5)] = 5
    """trials a scene: each draws the start, the rig's direction and rotation, and the thermal noise"""
    rgb: RgbConfig = field(default_factory=lambda: RgbConfig(quality="fast"))
    """training of the RGB models, one a scene"""
    workers: Annotated[int | None, Range(1, 10**4)] = None
    """processes; None: one a core"""

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def tables(self) -> tuple[SyntheticTable, ...]:
        """The tables that are asked for, in their order."""
        return SYNTHETIC_TABLES if self.table == "all" else (self.table,)

    def check(self) -> None:
        """Raises `RtgsError` where no scene is named, or one twice."""
        if not self.scenes:
            raise RtgsError(f"scenes: none is named; there are {', '.join(SCENES)}")
        if len(set(self.scenes)) < len(self.scenes):
            raise RtgsError("scenes: one is named twice")


@dataclass(frozen=True)
class ManualConfig:
    """A length that a person has measured."""

    frames: tuple[str, str] | None = None
    """two frames A and B: their RGB cameras are `metres` apart"""
    metres: Annotated[float | None, Range(above=0)] = None
    """the length"""
    pixels: Annotated[tuple[float, float, float, float, float, float, float, float] | None, Range()] = None
    """not the cameras but two points P and Q are `metres` apart: x and y of P, then of Q, in the RGB file of A; the same in B's"""

    def __post_init__(self) -> None:
        check_ranges(self, "manual")

    def check(self) -> None:
        """Raises `RtgsError` where half of it is missing."""
        if (self.frames is None) != (self.metres is None) or (self.pixels is not None and self.frames is None):
            raise RtgsError("--manual: a length needs --manual.frames A B and --manual.metres M, and --manual.pixels needs both.")
        if self.frames is not None and self.frames[0] == self.frames[1]:
            raise RtgsError(f"--manual.frames: {self.frames[0]} is named twice; a length needs two frames.")


@dataclass(frozen=True)
class RealExperimentConfig:
    """Settings of `rtgs experiment real`."""

    manual: ManualConfig = field(default_factory=ManualConfig)
    """row "Manual": the scale from a measured length"""
    mast3r_weights: Path | None = None
    """row "MASt3R": file of its weights; its package has to be on PYTHONPATH"""
    depth_model: Path | None = None
    """row "Metric depth": folder of a model for transformers"""
    plane_m: Annotated[float, Range(above=0)] = 1.0
    """row "Planar": distance of its plane from the thermal camera, in the unit of the rig's baseline"""
    region: Annotated[tuple[int, int, int, int] | None, Range(0)] = None
    """left, top, right and bottom in thermal pixels: its mean temperature is shown beside the thermal image's"""
    region_frame: str | None = None
    """held-out frame of the region; None: the first"""
    thermal: ThermalConfig = field(default_factory=lambda: ThermalConfig(geometry="frozen", drift="off"))
    """the thermal fit of every row, on the frozen geometry, as the paper has it, and without drift: "auto" decides row by row, and what a
    frame has of its own can hide a wrong scale"""

    def __post_init__(self) -> None:
        check_ranges(self)

    def check(self) -> None:
        """Raises `RtgsError` where half of a setting, or a file, is missing."""
        self.manual.check()
        if self.region is None and self.region_frame is not None:
            raise RtgsError("--region-frame: says where a --region is, and there is none.")
        for name, path in (("--mast3r-weights", self.mast3r_weights), ("--depth-model", self.depth_model)):
            if path is not None and not path.exists():
                raise RtgsError(f"{name} {path}: no such file or folder.")
