"""The global search finds the truth: in any unit, for any baseline, soft lens or striped sensor."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.helpers.scale_scenes import FORWARDS, GLOBAL, RIG, assembled, cloud, drawn, orbit, posts, spiral, synthetic
from tests.helpers.sensor_noise import sensor_stripes

from rtgs.config import ScaleConfig
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.models import RgbModel
from rtgs.records.camera import Camera
from rtgs.records.rig import Rig
from rtgs.renderer import RenderSettings
from rtgs.scale import Comparison, Objective, estimate_scale
from rtgs.scale.resampling import curve_minimum
from rtgs.scale.thermal_targets import halvings


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_global_search_finds_the_truth_in_any_unit(seed: int) -> None:
    truth, found = 1.3, []
    # The second rig's baseline points forwards, the third camera's field of view is another.
    rig = (RIG, FORWARDS, replace(RIG, thermal=replace(RIG.thermal, fl_x=48.0, fl_y=47.0)))[seed]
    for unit in (1e-4, 1.0, 1e4):
        scene, model = spiral(seed, rig, unit * truth, unit)
        estimate = estimate_scale(scene, model, GLOBAL)
        assert estimate.solver == "global" and estimate.status == "ok" and estimate.reason == ""
        assert estimate.sfm_per_metre == pytest.approx(unit * truth, rel=0.01)
        assert estimate.ci95 is not None and estimate.std_log is not None
        assert estimate.ci95[0] < estimate.sfm_per_metre < estimate.ci95[1] and 0 < estimate.std_log < 0.02
        assert not {"000", "008"} & set(estimate.frames) and estimate.disagreeing == ()
        assert estimate.renders < 200 * len(estimate.frames)
        found.append(estimate.sfm_per_metre / unit)
    np.testing.assert_allclose(found, found[1], rtol=2e-3)


@pytest.mark.thorough
@pytest.mark.parametrize("share", [0.25, 0.5])
def test_a_coarse_thermal_camera_and_half_of_the_view(share: float) -> None:
    """Thermal pixels four times as large, or a camera that sees beyond the model: silhouettes and a part of the picture remain."""
    camera = Camera("PINHOLE", 224, 192, 240.0, 240.0, 112.0, 96.0)
    thermal = camera.resized(56, 48) if share == 0.25 else replace(camera.resized(112, 96), cx=10.0)
    rig = replace(RIG, rgb=camera, thermal=thermal)
    model = RgbModel(cloud(2), torch.full((3,), 0.4), RenderSettings(near_plane=0.05))
    estimate = estimate_scale(drawn(model, orbit(), rig, 1.0, noise=0.3), model, GLOBAL)
    assert estimate.status == "ok" and estimate.sfm_per_metre == pytest.approx(1.0, rel=0.01)


def test_the_search_ends_in_the_minimum_of_the_loss_itself() -> None:
    scene, model = synthetic()
    estimate = estimate_scale(scene, model, ScaleConfig(solver="global", epsilon=0.05))
    loss = Objective(scene, model, scene.train_frames, EdgeLoss(epsilon=0.05))
    thetas = math.log(estimate.sfm_per_metre) + np.linspace(-0.02, 0.02, 41)
    curve = np.array([np.mean([loss.loss(i, t) for i in range(len(scene.train_frames))]) for t in thetas])
    assert abs(curve_minimum(thetas, curve) - math.log(estimate.sfm_per_metre)) < 2e-3
    assert curve[20] <= curve.min() + 1e-5


def test_a_start_spares_the_scan() -> None:
    scene, model = synthetic()
    estimate = estimate_scale(scene, model, ScaleConfig(solver="global", init=1.15))
    assert estimate.scan is None and estimate.init == pytest.approx(1.15)
    assert estimate.sfm_per_metre == pytest.approx(1.0, rel=0.01)


@pytest.mark.thorough
def test_a_loss_per_edge_does_not_prefer_to_stand_nearer() -> None:
    """Where the baseline points forwards, Eq. 6 with an ε of the size of edges falls with their number and sharpness."""
    scene, model = spiral(1, FORWARDS, 1.3)
    per_edge = estimate_scale(scene, model, GLOBAL).sfm_per_metre
    eq_6 = estimate_scale(scene, model, GLOBAL, comparison=Comparison(per_edge=False)).sfm_per_metre
    assert abs(per_edge / 1.3 - 1) < 0.01
    assert abs(eq_6 / 1.3 - 1) > 0.015


@pytest.mark.thorough
@pytest.mark.parametrize("weights", [(1.0,), (1.0, 1.0, 1.0, 1.0)])
def test_few_and_many_levels_at_a_size_that_is_halved(weights: tuple[float, ...]) -> None:
    rig = Rig(RIG.rgb.resized(168, 144), RIG.thermal.resized(168, 132), RIG.rgb_from_thermal)
    scene, model = spiral(0, rig, 1.3)
    assert halvings(scene) == 1
    found = estimate_scale(scene, model, replace(GLOBAL, level_weights=weights)).sfm_per_metre
    assert abs(found / 1.3 - 1) < 0.01


@pytest.mark.thorough
@pytest.mark.parametrize("across", [(0.75, 2.5), (0.0, 4.0)])
def test_other_derivative_filters_find_the_scale_too(across: tuple[float, float]) -> None:
    scene, model = spiral(0, RIG, 1.3)
    found = estimate_scale(scene, model, GLOBAL, comparison=Comparison(across=across)).sfm_per_metre
    assert abs(found / 1.3 - 1) < 0.01
    assert found != estimate_scale(scene, model, GLOBAL).sfm_per_metre


def test_a_striped_sensor_does_not_move_the_scale() -> None:
    scene, model = posts()
    pattern = sensor_stripes(np.random.default_rng(3), (44, 56), 4.0)
    images = [(f.thermal + pattern).astype(np.float32) for f in scene.frames]
    striped = assembled(list(scene.world_from_rgb.values()), images, RIG, [f.rgb for f in scene.frames])
    found = estimate_scale(striped, model, GLOBAL)
    assert found.status == "ok" and found.sfm_per_metre == pytest.approx(1.0, rel=0.01)
