"""Settings of the thermal model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class ThermalConfig:
    """Fit of the thermal spherical harmonics."""

    solver: Literal["linear", "adam"] = "linear"
    """Least squares by conjugate gradients; or the paper's Adam, to which alone the settings after `sh_degree` matter."""
    drift: Literal["auto", "off", "offset", "gain-offset"] = "auto"
    """What each frame has of its own (linear solver): "auto" decides on training frames that are left out of the fit."""
    sh_degree: int = 1
    """Highest band: emission depends on the direction only weakly."""
    steps: int = 1000
    """Optimisation steps; one image each."""
    learning_rate: float = 1e-2
    """Adam's rate of the constant band, falling tenfold; higher bands take a twentieth of it."""
    ssim_weight: float = 0.0
    """Loss = ℓ1 + this · (1 − SSIM)."""
    initial_noise: float = 0.0
    """Standard deviation of the initial coefficients; zero starts at the middle of the range."""
    seed: int = 0
    """Order of the frames and the initial noise."""
