"""Derivatives of the loss by all seven numbers of a rig, and the way down from a rig that is wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.helpers.scale_scenes import GLOBAL, RIG, spiral

from rtgs.scale.bracket import Bracket
from rtgs.scale.free_rig import EVERYTHING, SIZE, WITHOUT_BASELINE, FreeRig, FreeRigLoss
from rtgs.scale.problem import Problem
from rtgs.scale.progress import RenderProgress
from rtgs.scale.thermal_targets import Pictures


def of_spiral() -> tuple[FreeRigLoss, FreeRig]:
    """The loss, and the true rig."""
    scene, model = spiral(1, RIG, 1.0)
    problem = Problem(scene, model, scene.train_frames, Bracket(math.nan, math.nan), GLOBAL)
    true = scene.rig.rgb_from_thermal
    loss = FreeRigLoss.of(Pictures.of(problem), 2.3, RenderProgress(None))
    return loss, FreeRig(true.rotation, scene.world_per_metre(1.0) * true.translation, 0.0)


def test_derivatives_are_those_of_the_loss() -> None:
    loss, true = of_spiral()
    here = true.moved(loss.units * np.array([1.0, -0.6, 0.5, 0.8, -1.0, 0.5, 0.7]))
    found = loss.evaluate(0, [0, 2, 4, 6], here).gradient
    for k in range(SIZE):
        step = 0.1 * np.eye(SIZE)[k] * loss.units
        after, before = (loss.evaluate(0, [0, 2, 4, 6], here.moved(sign * step)).loss for sign in (1, -1))
        assert found[k] == pytest.approx((after - before) / 0.2, rel=0.05, abs=6e-4)


def test_a_step_of_one_moves_the_picture_by_about_a_pixel() -> None:
    loss, true = of_spiral()
    camera, points = loss.camera, np.random.default_rng(0).uniform([-0.8, -0.6, 2.0], [0.8, 0.6, 2.6], (200, 3))
    for k in range(SIZE):
        moved = true.moved(np.eye(SIZE)[k] * loss.units)
        seen = (moved.rgb_from_thermal.inverse() @ true.rgb_from_thermal).apply(points)
        shift = np.linalg.norm(loss.thermal_camera(moved).project(seen) - camera.project(points), axis=1)
        assert 0.2 < np.percentile(shift, 90) < 2.0


def test_losses_alone_are_those_with_derivatives() -> None:
    loss, true = of_spiral()
    here = true.moved(loss.units * np.array([1.0, 0.0, 0.5, 0.8, 0.0, 0.5, 0.7]))
    for halved in (0, 1):
        np.testing.assert_allclose(loss.losses(halved, [1, 3], here), loss.evaluate(halved, [1, 3], here).losses, atol=1e-6)


def test_a_motion_that_is_taken_back_leaves_the_rig_as_it_was() -> None:
    loss, true = of_spiral()
    motion = FreeRig(np.eye(3), np.zeros(3), 0.0).moved(loss.units * np.array([3.0, -2.0, 1.0, 4.0, 1.0, -2.0, 5.0]))
    pose = true.rgb_from_thermal @ motion.rgb_from_thermal  # the thermal camera moved in its own axes
    back = FreeRig(pose.rotation, pose.translation, true.log_zoom + motion.log_zoom).without(motion)
    np.testing.assert_allclose(back.rotation, true.rotation, atol=1e-12)
    np.testing.assert_allclose(back.translation, true.translation, atol=1e-12)
    assert back.log_zoom == pytest.approx(true.log_zoom, abs=1e-12)


@pytest.mark.thorough
def test_a_descent_goes_on_with_the_curvature_of_another() -> None:
    loss, true = of_spiral()
    start = true.moved(loss.units * np.array([1.0, -1.0, 0.5, -1.0, 1.0, 0.5, 1.0]))
    every = range(len(loss.pictures.frames))
    before = loss.descend(0, every[::2], start, EVERYTHING)
    assert before.curvature is not None and before.curvature.shape == (SIZE, SIZE)
    after = loss.descend(0, every, before.rig, EVERYTHING, before.curvature)
    assert after.loss <= loss.evaluate(0, every, before.rig).loss
    assert np.linalg.eigvalsh(before.curvature).min() > 0


@pytest.mark.thorough
def test_the_way_down_leads_to_the_true_rig() -> None:
    loss, true = of_spiral()
    start = true.moved(loss.units * np.array([1.5, -1.0, 1.0, -1.5, 1.0, 0.5, 1.0]))
    every = range(len(loss.pictures.frames))
    found = loss.descend(0, every, start, EVERYTHING)
    assert found.loss <= loss.evaluate(0, every, true).loss + 1e-5
    assert np.linalg.norm(found.rig.translation - true.translation) < 0.15 * np.linalg.norm(true.translation)
    assert abs(found.rig.log_zoom) < 0.01


def test_what_is_held_does_not_move() -> None:
    loss, true = of_spiral()
    start = true.moved(loss.units * np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    found = loss.descend(0, [0, 3, 6, 9], start, WITHOUT_BASELINE)
    np.testing.assert_array_equal(found.rig.translation, start.translation)
    assert found.rig.log_zoom != start.log_zoom
