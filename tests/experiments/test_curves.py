"""A solver replayed on curves that were rendered once does what it does when it renders at every step."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from rtgs.config import ScaleConfig
from rtgs.experiments.curves import Curves, _Mean, replay
from rtgs.experiments.methods import normalised_thermal
from rtgs.experiments.rivals import INERF_L1, INERF_SSIM, NGF_PYRAMID, Rival
from rtgs.experiments.rivals.ngf_pyramid import Ngf
from rtgs.experiments.trials import Trial
from rtgs.experiments.variants import REFERENCE_ROW
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.scale import Objective
from rtgs.scale.adam import descend_by_adam

pytestmark = pytest.mark.thorough

SMOOTH = Rival("smooth", "ε of the size of edges", lambda thermal, mask: Ngf(thermal, mask, EdgeLoss(epsilon=0.1)), smooth_px=0.5)
PAPER = ScaleConfig(solver="adam", steps=30, learning_rate=0.01)


@dataclass(frozen=True)
class Stage:
    """A trial's training frames: their renderer, and thermal images in [0, 1]."""

    objective: Objective
    images: dict[str, NDArray[np.float32]]
    mask: NDArray[np.bool_]

    def curves(self, *rivals: Rival, pixel: float) -> Curves:
        return Curves(self.objective, {r.key: (r, [r.loss(i, self.mask) for i in self.images.values()]) for r in rivals}, pixel)


@pytest.fixture(scope="module")
def stage(trial: Trial) -> Stage:
    scene, model = trial.scene(REFERENCE_ROW, trial.temperatures(None)), trial.model
    return Stage(Objective(scene, model, scene.train_frames, EdgeLoss()), normalised_thermal(scene), scene.capture.thermal_mask)


@pytest.mark.parametrize(
    ("rival", "tolerance"),
    [(INERF_L1, 1e-3), (INERF_SSIM, 1e-3), (SMOOTH, 2e-4), (NGF_PYRAMID, 1e-9)],  # the last renders at each step
    ids=lambda value: value.key if isinstance(value, Rival) else "",
)
def test_a_replay_is_the_run(rival: Rival, tolerance: float, stage: Stage, trial: Trial) -> None:
    """Adam on curves against Adam that renders at every step, from both sides."""
    curves = stage.curves(rival, pixel=0.03 * trial.truth)
    run = rival.objective(stage.objective, stage.images, stage.mask)
    for start in (0.86, 1.14):
        expected = descend_by_adam(run, math.log(start * trial.truth), PAPER)
        found = replay(curves, rival.key, math.log(start * trial.truth), PAPER)
        assert abs(found.theta - expected.theta) < tolerance
        assert np.ptp(expected.history.sfm_per_metre) > 0.01 * trial.truth, "it stood still"
        assert found.history.loss[0] == pytest.approx(expected.history.loss[0], rel=0.01)


def test_what_is_rendered_for_one_serves_the_others(stage: Stage, trial: Trial) -> None:
    curves = stage.curves(SMOOTH, INERF_L1, NGF_PYRAMID, pixel=0.03 * trial.truth)
    step = 0.5 * curves.pixel
    curves.node(20 * step, SMOOTH.key)
    for rival in (SMOOTH, INERF_L1, NGF_PYRAMID):
        curves.node(20 * step, rival.key)
    assert curves.renders == len(stage.images)
    curves.node(20.1 * step, NGF_PYRAMID.key)  # smooth losses need no such crowd
    assert curves.around(INERF_L1.key, 20.2 * step) == (20 * step, None)
    assert curves.around(NGF_PYRAMID.key, 20.2 * step) == (20.1 * step, None)
    assert curves.seconds_each(SMOOTH.key) > 0


def test_slopes_at_nodes_and_between(stage: Stage, trial: Trial) -> None:
    curves = stage.curves(SMOOTH, pixel=0.03 * trial.truth)
    step, losses = 0.5 * curves.pixel, [SMOOTH.loss(i, stage.mask) for i in stage.images.values()]
    ends = np.array([[loss(*stage.objective.picture(i, math.log(k * step))) for i, loss in enumerate(losses)] for k in (60, 61)])
    for chosen, values in ((None, ends.mean(axis=1)), ([1, 4], ends[:, [1, 4]].mean(axis=1))):
        mean = _Mean(curves, SMOOTH.key, chosen)
        between = 0.75 * values[0] + 0.25 * values[1]
        assert mean.loss_and_slope(0, math.log(60 * step * (1 + 1e-12))) == pytest.approx(tuple(values[0]), rel=1e-6)
        assert mean.loss_and_slope(0, math.log(60.25 * step)) == pytest.approx(tuple(between), rel=1e-6)
    assert curves.renders == 2 * len(stage.images)
    least = _Mean(curves, SMOOTH.key, None)
    assert least.loss_and_slope(0, math.log(0.2 * step)) == least.loss_and_slope(0, math.log(step))
