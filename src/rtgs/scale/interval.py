"""How sure the scale is: the scatter between frames, the model's share and the calibration's."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from rtgs.scale.bracket import Bracket
from rtgs.scale.calibration import calibration_std_log
from rtgs.scale.misfit import NO_MISFIT, Misfit, misfit
from rtgs.scale.problem import Found, Problem
from rtgs.scale.resampling import QUANTILE_95, block_length, curve_minimum, resampled_minima, small_sample_factor

WIDEST = 0.5  # half-width of a 95 % interval in ln s, from which on a number would only mislead
MODEL_PIXELS = 0.05
"""Edges of a render lie beside those of the photograph, by about this much in many frames alike (`benchmarks/scale_coverage.py`)."""

_MISFIT_WEIGHT = float(special.stdtrit(2, 0.975) / special.ndtri(0.975))  # 2.2: two directions tell the size of a third

_BLUR_SHARE = 0.1  # of the blur, to which an edge is placed in it where modalities differ (chosen on `--table 2`)


@dataclass(frozen=True)
class Interval:
    """Standard deviation of ln s and the 95 % interval of s; None where a single frame tells nothing about its error, or withheld.

    Attributes:
        calibration_std_log: share of `std_log` that is the calibration's; None where the rig states none.
        misfit: how far the edges miss each other beside the scale.
    """

    std_log: float | None
    ci95: tuple[float, float] | None
    calibration_std_log: float | None
    misfit: Misfit = NO_MISFIT

    @property
    def half_width(self) -> float:
        """Of the 95 % interval in ln s; 0 where there is none."""
        return 0.0 if self.std_log is None else QUANTILE_95 * self.std_log


def find_interval(problem: Problem, found: Found) -> Interval:
    """The interval around a solver's answer, after measuring what all frames have alike."""
    curves, progress = found.curves, problem.progress
    calibration = calibration_std_log(curves.objective, found.theta, curves.frames)
    missed = NO_MISFIT
    if len(curves.frames) > 1 and not (found.doubt or problem.config.refine):
        missed = misfit(problem.scene, problem.model, curves, found.theta, progress)
    return interval_of(found, problem.bracket, calibration, missed, problem.config.seed)


def interval_of(found: Found, bracket: Bracket, calibration: float | None, missed: Misfit, seed: int) -> Interval:
    """The interval around a solver's answer: the scatter of the frames, and what all frames have alike.

    The latter is what model and calibration are known to be off by, and how much further the edges are seen to miss each other. A misfit
    tells the size of an unseen error of the same kind from two directions (across the flow, and about the view), as if from a sample of
    two: Student's quantile takes the normal distribution's place.
    """
    if len(found.curves.frames) < 2:
        return Interval(None, None, calibration)
    known = math.hypot(model_pixels(found.blur_px), (calibration or 0.0) * bracket.flow_px(found.theta))
    excess = math.sqrt(max(0.0, missed.px**2 - known**2))
    common = min(bracket.pixel(found.theta, math.hypot(known, _MISFIT_WEIGHT * excess)), 2 * WIDEST)
    return Interval(*resampled_interval(*found.curves.dense(), found.theta, common, seed), calibration, missed)


def model_pixels(blur_px: float, sharp: float = MODEL_PIXELS) -> float:
    """Standard deviation of where the model's edges lie, in pixels: `sharp` for sharp thermal images, more for soft ones."""
    return math.hypot(sharp, _BLUR_SHARE * blur_px)


def resampled_interval(
    thetas: NDArray[np.float64], curves: NDArray[np.float64], theta: float, common_std_log: float, seed: int
) -> tuple[float, tuple[float, float]]:
    """Standard deviation of ln s and its 95 % interval: the resampled minima, widened for small samples and for what all frames share.

    Args:
        thetas: `[S]`, rising. curves: `[F, S]`, the frames' losses.
        theta: the answer, which the interval contains in any case. The resamples' scatter about their median is put around the mean
            curve's minimum, the same place for a solver that found it.
        common_std_log: standard deviation of ln s that all frames have alike: no resampling of them shows it.
    """
    block = block_length(len(curves))
    minima = resampled_minima(thetas, curves, seed, block)
    factor = small_sample_factor(len(curves), block)
    spread = (minima - np.median(minima)) * factor
    noise = np.random.default_rng(seed + 1).normal(size=len(spread)) * common_std_log
    lo, hi = np.percentile(spread + noise, [2.5, 97.5])
    std = math.hypot(float(minima.std()) * factor, common_std_log)
    centre = curve_minimum(thetas, curves.mean(axis=0))
    return std, (math.exp(min(centre + lo, theta)), math.exp(max(centre + hi, theta)))
