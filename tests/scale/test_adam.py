"""The paper's solver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.scale_scenes import QUICK, RIG, assembled, objective, synthetic

from rtgs.config import ScaleConfig
from rtgs.maths.geometry import SE3
from rtgs.renderer import render
from rtgs.scale import estimate_scale
from rtgs.scale.adam import descend_by_adam


@pytest.mark.thorough
@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_the_truth_is_found_in_any_sfm_unit_without_a_start(unit: float) -> None:
    scene, model = synthetic(unit)
    estimate = estimate_scale(scene, model, QUICK)
    assert estimate.sfm_per_metre == pytest.approx(unit, rel=0.01)
    assert estimate.metres_per_sfm == pytest.approx(1 / unit, rel=0.01)
    assert estimate.status == "ok" and estimate.reason == ""
    assert estimate.bracket[0] < unit < estimate.bracket[1]
    assert estimate.frames == tuple(f.name for f in scene.train_frames) and "000" not in estimate.frames
    assert estimate.baseline_m == pytest.approx(RIG.baseline_m)
    assert estimate.scan is not None and len(estimate.scan.loss) == QUICK.scan_samples
    assert set(estimate.scan.per_frame) == set(estimate.frames)
    assert estimate.std_log is not None and estimate.ci95 is not None
    # Noise counts as edges under the paper's ε, and leaves a misfit of 0.08 px in these small pictures with 5 px of flow.
    assert estimate.misfit_px < 0.1
    assert 0 < estimate.std_log < 0.025 and estimate.ci95[0] <= estimate.sfm_per_metre * 1.005
    assert len(estimate.history.step) == QUICK.steps and estimate.history.sfm_per_metre[0] == pytest.approx(estimate.init)


@pytest.mark.parametrize("factor", [1 / 1.8, 1.8])
def test_the_truth_is_found_from_a_start_far_off(factor: float) -> None:
    scene, model = synthetic()
    estimate = estimate_scale(scene, model, replace(QUICK, init=factor, steps=80))
    assert estimate.sfm_per_metre == pytest.approx(1.0, rel=0.01)
    assert estimate.scan is None and estimate.init == factor
    assert estimate.history.sfm_per_metre[0] == pytest.approx(factor)


@pytest.mark.parametrize(
    "change", [{"batch": 2, "learning_rate": 5e-3}, {"level_weights": (1.0,)}, {"epsilon": 0.05}, {"max_frames": 4}]
)
def test_the_truth_is_found_with_other_settings(change: dict) -> None:
    scene, model = synthetic()
    estimate = estimate_scale(scene, model, replace(QUICK, init=1.1, **change))
    assert estimate.sfm_per_metre == pytest.approx(1.0, rel=0.01)
    assert len(estimate.frames) == change.get("max_frames", 7)


def test_mini_batches_are_drawn_anew_and_by_the_seed() -> None:
    scene, model = synthetic()
    loss = objective(scene, model, 0.05, reference=False)
    runs = [descend_by_adam(loss, 0.1, ScaleConfig(steps=8, batch=1, seed=seed)).history.loss for seed in (0, 0, 1)]
    assert runs[0] == runs[1] != runs[2]


def test_a_scale_that_is_too_small_to_see_is_not_sold_as_found() -> None:
    # The thermal images of a rig without a baseline: the best scale is zero, below everything the images can tell.
    scene, model = synthetic()
    without = replace(scene.rig, rgb_from_thermal=SE3(RIG.rgb_from_thermal.rotation, np.zeros(3)))
    images = [
        render(
            replace(model.gaussians, sh=-model.gaussians.sh.mean(2, keepdim=True)),
            RIG.thermal,
            assembled([scene.world_from_rgb[f.name]], [f.thermal], without).thermal_from_world("000", 1.0),
        )
        .color[..., 0]
        .numpy()
        for f in scene.frames
    ]
    blind = assembled(list(scene.world_from_rgb.values()), images)
    for config in (replace(QUICK, steps=2), replace(QUICK, init=0.02, steps=2)):
        estimate = estimate_scale(blind, model, config)
        assert estimate.status == "unobservable" and "below" in estimate.reason
