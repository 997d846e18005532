"""Minima of curves, and how resampling the frames scatters them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgs.scale.resampling import curve_minima, curve_minimum, resampled_minima, significance


def test_minimum_of_a_parabola_is_found_between_uneven_samples() -> None:
    thetas = np.array([-0.4, -0.1, 0.0, 0.05, 0.3])
    assert curve_minimum(thetas, 3 * (thetas - 0.02) ** 2 + 5) == pytest.approx(0.02, abs=1e-9)
    assert curve_minimum(thetas, thetas) == -0.4 and curve_minimum(thetas, -thetas) == 0.3
    assert curve_minimum(thetas, np.array([1.0, 0.0, 0.0, 0.0, 1.0])) == pytest.approx(-0.1, abs=0.3)  # flat: no number is wrong


def test_minima_of_many_curves_are_those_of_each() -> None:
    rng = np.random.default_rng(0)
    thetas = np.sort(rng.uniform(-1, 1, 9))
    curves = np.concatenate([(thetas - rng.uniform(-1.5, 1.5, (200, 1))) ** 2, rng.normal(size=(200, 9))])
    expected = []
    for curve in curves:
        k = int(np.argmin(curve))
        if k in (0, 8):
            expected.append(thetas[k])
            continue
        a, b, _ = np.polyfit(thetas[k - 1 : k + 2] - thetas[k], curve[k - 1 : k + 2], 2)
        expected.append(thetas[k] - b / (2 * a))
    np.testing.assert_allclose(curve_minima(thetas, curves), expected, atol=1e-9)


def test_resampled_parabolas_scatter_as_the_error_of_their_mean() -> None:
    rng = np.random.default_rng(0)
    thetas, minima = np.linspace(-1, 1, 41) + 0.5, rng.normal(0.5, 0.1, 25)
    curves = 2 * (thetas[None] - minima[:, None]) ** 2 + rng.normal(size=(25, 1))
    found = resampled_minima(thetas, curves, seed=0)
    # The minimum of a mean of equal parabolas is the mean of their minima. 1000 resamples know a deviation to 2–3 %.
    expected = minima.std() / 5
    assert found.std() == pytest.approx(expected, rel=0.1)
    for percentile, place in ((2.5, -1.96), (97.5, 1.96)):
        assert np.percentile(found, percentile) == pytest.approx(minima.mean() + place * expected, abs=0.3 * expected)
    np.testing.assert_array_equal(resampled_minima(thetas, curves, seed=0), found)
    same = resampled_minima(thetas, np.repeat(curves[:1], 6, axis=0), seed=0)
    assert np.ptp(same) == pytest.approx(0.0, abs=1e-12)


def test_significance_is_the_mean_in_standard_errors() -> None:
    assert significance(np.array([1.0, 3.0])) == pytest.approx(2.0)
    assert significance(np.array([-0.5])) == -math.inf and significance(np.array([2.0, 2.0])) == math.inf
    assert significance(np.zeros(3)) == 0.0
