"""The interval covers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgs.scale.bracket import Bracket
from rtgs.scale.curves import LocalCurves
from rtgs.scale.interval import MODEL_PIXELS, interval_of, resampled_interval
from rtgs.scale.misfit import NO_MISFIT, Misfit
from rtgs.scale.objective import FrameLoss
from rtgs.scale.problem import Found
from rtgs.scale.records import History
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


def sharp_curves(frames: int = 9) -> Found:
    """Frames that all have their minimum at θ = 0."""
    thetas = tuple(np.linspace(-1.0, 1.0, 41).tolist())
    evaluations = {(i, t): FrameLoss(t * t, 2 * t, 2.0) for i in range(frames) for t in thetas}
    curves = LocalCurves(None, tuple(range(frames)), thetas, evaluations)  # type: ignore[arg-type]  # nothing is rendered
    return Found(0.0, 1.0, curves, True, History(), 0)


BRACKET = Bracket(0.05, 5.0)  # 10 px of flow at s = 1, so that a pixel is 0.1 in ln s


def test_a_misfit_widens_the_interval_where_it_exceeds_what_is_known() -> None:
    def std(px: float, calibration: float | None = None) -> float:
        interval = interval_of(sharp_curves(), BRACKET, calibration, Misfit(px, 9), 0)
        assert interval.std_log is not None and interval.misfit.px == px
        return interval.std_log

    assert std(0.0) == std(MODEL_PIXELS) == pytest.approx(0.1 * MODEL_PIXELS, rel=1e-6)
    # Two directions tell the size of a third: Student's 4.30 in the place of 1.96.
    assert std(1.0) == pytest.approx(0.1 * math.hypot(MODEL_PIXELS, 4.303 / 1.960 * math.sqrt(1 - MODEL_PIXELS**2)), rel=1e-3)
    # A calibration that states an error of a pixel explains a misfit of a pixel.
    assert std(1.0, 0.1) == std(0.0, 0.1) == pytest.approx(0.1 * math.hypot(1.0, MODEL_PIXELS), rel=1e-6)
    assert std(1e6) == pytest.approx(1.0, rel=1e-6)  # never beyond what makes the scale unobservable


def test_a_single_frame_has_no_interval() -> None:
    interval = interval_of(sharp_curves(1), BRACKET, 0.01, NO_MISFIT, 0)
    assert interval.std_log is None and interval.ci95 is None and interval.calibration_std_log == 0.01
