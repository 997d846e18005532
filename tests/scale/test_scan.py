"""The scan: its scales, and which of its minima are gone on with."""

from __future__ import annotations

import numpy as np
import pytest

from rtgs.scale.bracket import Bracket
from rtgs.scale.scan import local_minima, scan_thetas


def test_scanned_scales_are_a_coarse_pixel_apart() -> None:
    thetas = scan_thetas(Bracket(0.02, 2.0), 4)
    flow = np.exp(thetas) / 0.04  # pixels: half of one at the lower end
    assert flow[0] == pytest.approx(0.5) and flow[-1] == pytest.approx(50.0)
    assert (np.diff(flow) <= 4 + 1e-9).all() and (flow[1:] / flow[:-1] <= 1.25 + 1e-9).all() and len(flow) < 30


def test_rivals_of_the_best_minimum() -> None:
    mean = np.array([5.0, 1.0, 5.0, 1.2, 5.0, 4.0, 5.0, 3.5])
    noise = np.random.default_rng(0).normal(size=(400, len(mean)))
    sure = mean + 0.01 * noise
    assert local_minima(sure) == [1, 3]  # half as deep below the median is deep enough, the other two are not
    assert local_minima(mean + 20.0 * (noise - noise.mean(axis=0))) == [1, 3, 7, 5]  # nothing is significant
