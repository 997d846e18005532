"""Settings of a run: those of its stages, nested."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from rtgs.config.metres import MetresConfig
from rtgs.config.ranges import Range, check_ranges
from rtgs.config.rgb import RgbConfig
from rtgs.config.scale import ScaleConfig
from rtgs.config.sfm import SfmConfig
from rtgs.config.thermal import ThermalConfig


@dataclass(frozen=True)
class RunConfig:
    """Settings of a run, stage by stage."""

    rgb_max_side: Annotated[int, Range(16, 10**5)] = 960
    """RGB images are reduced to this many pixels on their longer side."""
    memory_gb: Annotated[float | None, Range(above=0, most=10**6)] = None
    """Memory that the run may take, in GB (10⁹ bytes); None: 4, or three quarters of what is free where that is less. Images and weights
    that do not fit are computed again, which takes longer."""
    rgb_ply: Path | None = None
    """A trained 3DGS model in the frame and unit of the capture's poses, to use instead of training one."""
    sfm: SfmConfig = field(default_factory=SfmConfig)
    """Structure from motion, where the capture has no poses or no points."""
    rgb: RgbConfig = field(default_factory=RgbConfig)
    """The RGB model."""
    scale: ScaleConfig = field(default_factory=ScaleConfig)
    """The metric scale."""
    metres: MetresConfig = field(default_factory=MetresConfig)
    """What lengths in metres rest on."""
    thermal: ThermalConfig = field(default_factory=ThermalConfig)
    """The thermal model."""

    def __post_init__(self) -> None:
        check_ranges(self)
