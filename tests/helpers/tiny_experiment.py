"""Settings of `rtgs experiment synthetic` that are done in seconds, and what is known of one that was stopped."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rtgs.config import DensifyConfig, RgbConfig, SyntheticExperimentConfig

CONFIG = SyntheticExperimentConfig(
    size=64,
    frames=9,
    scenes=("lego",),
    seeds=1,
    rgb=RgbConfig(steps=120, sh_degree=0, densify=DensifyConfig(max_gaussians=1500), random_points=1500),
    workers=1,
)


class StopError(Exception):
    pass


@dataclass(frozen=True)
class Stopped:
    """An experiment that was stopped after its first trial and gone on with, one record having been removed in between."""

    out: Path
    times: dict[Path, int]  # of what there was before going on
    removed: dict[str, Any]
