"""Cubics through losses and slopes, and how far they are followed."""

from __future__ import annotations

import numpy as np
from tests.helpers.scale_scenes import objective, synthetic

from rtgs.scale.curves import LocalCurves, Window, hermite, widened
from rtgs.scale.objective import FrameLoss
from rtgs.scale.progress import RenderProgress


def test_cubics_are_read_exactly_between_their_nodes() -> None:
    thetas, at = np.array([-1.0, -0.2, 0.1, 2.0]), np.linspace(-1, 2, 50)
    cubics = [np.poly1d([0.3, -1, 0.5, 2]), np.poly1d([-1, 0, 0, 1])]
    values, slopes = np.array([p(thetas) for p in cubics]), np.array([p.deriv()(thetas) for p in cubics])
    np.testing.assert_allclose(hermite(thetas, values, slopes, at), [p(at) for p in cubics], atol=1e-12)


class Flat:
    """An objective that says nothing."""

    def evaluate(self, index: int, theta: float) -> FrameLoss:
        assert abs(theta) < 50, "so far out nothing is to be looked for"
        return FrameLoss(1.0, 0.0, 1.0)


def test_a_loss_that_says_nothing_is_not_followed_for_ever() -> None:
    curves, closed = widened(LocalCurves(Flat()), range(6), Window(-20.0, 1e6, 1e6), 0, RenderProgress(None))  # type: ignore[arg-type]
    assert not closed and curves.frames == tuple(range(6))


def test_curves_are_extended_by_what_is_missing() -> None:
    scene, model = synthetic()
    none, lines = LocalCurves(objective(scene, model, 0.05)), list[str]()
    progress = RenderProgress(lambda done, total, text: lines.append(text))
    first = none.extended(progress, frames=[1], thetas=[0.1, -0.1])
    both = first.extended(progress, frames=[0], thetas=[0.0])
    assert none.renders == 0 and first.renders == 2 and both.renders == len(lines) == 6
    assert both.frames == (0, 1) and both.thetas == (-0.1, 0.0, 0.1) and both.values().shape == (2, 3)
    assert both.evaluations[1, 0.1] == first.evaluations[1, 0.1] == none.objective.evaluate(1, 0.1)
    assert both.scan().loss == tuple(both.values().mean(axis=0))
