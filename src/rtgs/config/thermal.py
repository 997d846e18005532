"""Settings of the thermal model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from rtgs.config.ranges import Range, check_ranges

DriftKind = Literal["off", "offset", "gain-offset"]
GeometrySetting = Literal["frozen", "follow", "refine"]
DriftSetting = Literal["auto", DriftKind]


@dataclass(frozen=True)
class ThermalConfig:
    """Fit of the thermal spherical harmonics."""

    solver: Literal["linear", "adam"] = "linear"
    """"linear": least squares by conjugate gradients. "adam": the paper's solver; the settings after `sh_degree` are for it alone."""
    geometry: GeometrySetting = "follow"
    """"follow": Gaussians are split where the thermal images show more than RGB needed, so that the thermal model has more of them than the
    RGB model (linear solver). "refine": they are also moved and reshaped before, if validation frames agree. "frozen": the RGB model's
    Gaussians as they are, the paper's protocol."""
    drift: DriftSetting = "auto"
    """Drift of each photograph (linear solver): an offset, or a gain and an offset. "auto" decides it on validation frames, which are
    training frames that are left out of the fit meanwhile."""
    sh_degree: Annotated[int, Range(0, 3)] = 1
    """Highest band of the harmonics. Emission depends on the direction only weakly."""
    steps: Annotated[int, Range(0, 10**7)] = 1000
    """Optimisation steps, one image each."""
    learning_rate: Annotated[float, Range(above=0, most=10)] = 1e-2
    """Adam's rate for the constant band. It falls tenfold over the fit; higher bands have a twentieth of it."""
    ssim_weight: Annotated[float, Range(0, 100)] = 0.0
    """Loss = ℓ1 + this · (1 − SSIM)."""
    initial_noise: Annotated[float, Range(0, 100)] = 0.0
    """Standard deviation of the initial coefficients; 0 starts at the middle of the range."""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """Seed of the frames' order and of the initial noise."""

    def __post_init__(self) -> None:
        check_ranges(self, "thermal")
