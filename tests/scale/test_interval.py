"""The interval covers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgs.scale.interval import resampled_interval
from rtgs.scale.resampling import curve_minimum


@pytest.mark.parametrize("calibration", [0.0, 0.02])
def test_the_interval_covers(calibration: float) -> None:
    """Frames in runs that err alike, few of them, and a calibration that is off: 95 % of the intervals hold the truth."""
    rng, thetas, trials = np.random.default_rng(1), np.linspace(-0.5, 0.5, 101), 300
    held, widths = 0, []
    for trial in range(trials):
        errors = 0.05 * (rng.normal(size=18) + np.repeat(rng.normal(size=6), 3)) / math.sqrt(2)
        minima = errors + calibration * rng.normal()
        curves = rng.uniform(0.5, 2.0, (18, 1)) * (thetas[None] - minima[:, None]) ** 2 + rng.normal(size=(18, 1))
        std, (lo, hi) = resampled_interval(thetas, curves, curve_minimum(thetas, curves.mean(axis=0)), calibration, trial)
        held += lo <= 1.0 <= hi
        widths.append(std)
    # 300 trials know a share of 95 % to ± 2.5 % (two standard errors); resampling 18 frames is itself an approximation.
    assert 0.90 <= held / trials <= 0.99
    assert np.median(widths) < 2.2 * math.hypot(0.05 / math.sqrt(18) * math.sqrt(2), calibration)
