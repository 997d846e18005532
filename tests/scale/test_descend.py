"""Gauss–Newton for one unknown."""

from __future__ import annotations

import math

import pytest

from rtgs.scale.descend import descend
from rtgs.scale.objective import FrameLoss
from rtgs.scale.progress import RenderProgress


class Parabola:
    """An objective of known minimum: L = 1 + a·(cosh(θ − m) − 1), whose Gauss–Newton curvature is claimed `excess` times too large."""

    def __init__(self, minimum: float, excess: float) -> None:
        self.minimum, self.excess, self.frames = minimum, excess, (0, 1)

    def evaluate(self, index: int, theta: float) -> FrameLoss:
        x = theta - self.minimum
        return FrameLoss(1 + 2 * (math.cosh(x) - 1), 2 * math.sinh(x), self.excess * 2 * math.cosh(x))


@pytest.mark.parametrize("excess", [0.1, 1.0, 30.0, 1e5])
def test_descent_reaches_the_minimum_whatever_the_claimed_curvature(excess: float) -> None:
    lines: list[str] = []
    progress = RenderProgress(lambda done, total, text: lines.append(text))
    found = descend(Parabola(0.3, excess), (0, 1), -0.4, pixel=0.5, tolerance=1e-4, progress=progress)
    assert found.place.theta == pytest.approx(0.3, abs=1e-4) and len(found.steps) <= 12
    assert found.place.curvature == pytest.approx(2.0, rel=0.1)
    assert found.renders == 2 * len(found.steps) == len(lines)
    assert found.steps[0].theta == -0.4 and min(s.loss for s in found.steps) == found.place.loss
