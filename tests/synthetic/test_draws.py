"""What is drawn at random."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.synthetic_captures import SMALL

from rtgs.synthetic.draws import sfm_per_metre_of

pytest.importorskip("embreex")


def test_units_are_drawn_log_uniformly() -> None:
    drawn = np.log([sfm_per_metre_of(replace(SMALL, seed=k)) for k in range(600)])
    low, high = math.log(0.05), math.log(20)
    assert drawn.min() >= low and drawn.max() <= high
    uniform = (np.sort(drawn) - low) / (high - low)
    assert np.abs(uniform - (np.arange(600) + 0.5) / 600).max() < 0.08  # Kolmogorov–Smirnov, far in the tail
    assert sfm_per_metre_of(replace(SMALL, sfm_per_metre=1.0)) == 1.0
