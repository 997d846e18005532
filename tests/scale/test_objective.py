"""The objective: its slope in forward and reverse mode, the back ends, reduced and blurred pictures."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.helpers.scale_scenes import GLOBAL, RIG, objective, spiral, synthetic

from reverse_mode import loss_and_slope_in_reverse
from rtgs.config import PAPER_EPSILON
from rtgs.images.filters import blurred
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.losses.ngf import NgfPyramid
from rtgs.scale import Objective
from rtgs.scale.problem import Problem
from rtgs.scale.thermal_targets import Pictures


@pytest.mark.thorough
@pytest.mark.parametrize("epsilon", [PAPER_EPSILON, 0.05])
@pytest.mark.parametrize("theta", [-0.3, 0.02])
def test_slope_equals_central_differences_in_float64(theta: float, epsilon: float) -> None:
    # Each splat's 1/255 edge crosses pixels at a few thousand values of θ per unit, and each crossing is a jump the derivative does
    # not see: a step of 1e-7 meets none, and float64 still gives the difference eight digits less seven.
    scene, model = synthetic()
    loss, h = objective(scene, model, epsilon, reference=True), 1e-7
    value, slope = loss.loss_and_slope(1, theta)
    assert value == pytest.approx(loss.loss(1, theta), abs=1e-12)
    expected = (loss.loss(1, theta + h) - loss.loss(1, theta - h)) / (2 * h)
    assert abs(expected) > 0.01
    assert slope == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("theta", [-0.3, 0.02])
def test_slope_of_the_cpu_back_end(theta: float) -> None:
    scene, model = synthetic()
    fast, slow = (objective(scene, model, 0.05, reference=r) for r in (False, True))
    for frame in (0, 1):
        value, slope = fast.loss_and_slope(frame, theta)
        expected_value, expected_slope = slow.loss_and_slope(frame, theta)
        # The image agrees to 1e-5 and ε is 0.05, so the loss to 1e-4 and better; the slope is a difference of like terms.
        assert value == pytest.approx(expected_value, abs=1e-4)
        assert slope == pytest.approx(expected_slope, rel=5e-3, abs=1e-3)
        # And by the loss itself: its float32 noise is 1e-6 and its jumps even out over a step of 5e-3.
        secant = (fast.loss(frame, theta + 5e-3) - fast.loss(frame, theta - 5e-3)) / 1e-2
        assert slope == pytest.approx(secant, rel=0.25, abs=0.05)


@pytest.mark.thorough
@pytest.mark.parametrize("reference", [False, True])
@pytest.mark.parametrize("theta", [-0.3, 0.02])
def test_forward_mode_equals_reverse_mode(theta: float, reference: bool) -> None:
    scene, model = synthetic()
    loss = objective(scene, model, 0.05, reference=reference)
    for frame in (0, 1):
        (value, slope), expected = loss.loss_and_slope(frame, theta), loss_and_slope_in_reverse(loss, frame, theta)
        assert value == pytest.approx(expected[0], abs=1e-12 if reference else 1e-5)
        # float32: a slope is a sum of 2000 terms that largely cancel.
        assert slope == pytest.approx(expected[1], rel=1e-9 if reference else 2e-3, abs=1e-9 if reference else 2e-4)


def test_curvature_is_that_of_the_residuals_in_both_back_ends() -> None:
    scene, model = synthetic()
    fast, slow = (objective(scene, model, 0.05, reference=r) for r in (False, True))
    for theta in (-0.3, 0.02):
        found, expected = fast.evaluate(0, theta), slow.evaluate(0, theta)
        assert expected.curvature > 1.0
        assert found.curvature == pytest.approx(expected.curvature, rel=5e-3)
        assert (found.loss, found.slope) == fast.loss_and_slope(0, theta)


def test_a_reduced_objective_compares_pictures_drawn_small() -> None:
    scene, model = synthetic()
    small = Objective(scene, model, scene.train_frames[:2], EdgeLoss((1.0,), epsilon=0.05), reduction=3)
    camera = RIG.thermal.reduced(3)
    assert (camera.width, camera.height) == (18, 14) and small.gray(0, torch.tensor(0.0)).shape == (14, 18)
    # 56 = 3 · 18 + 2: the focal length is a third all the same, and a ray keeps its block.
    assert camera.fl_x == RIG.thermal.fl_x / 3 and camera.cy == RIG.thermal.cy / 3
    assert small.loss(0, 0.0) < small.loss(0, 0.5)


def test_the_loss_falls_towards_the_truth_from_both_sides() -> None:
    scene, model = synthetic()
    loss = objective(scene, model, PAPER_EPSILON, reference=False)
    values = [np.mean([loss.loss(i, t) for i in (0, 1)]) for t in (-0.4, -0.1, 0.0, 0.1, 0.4)]
    assert values[0] > values[1] > values[2] < values[3] < values[4]


def test_a_slope_without_anything_in_view_is_zero() -> None:
    scene, model = synthetic()
    nothing = replace(model, gaussians=replace(model.gaussians, opacity_logits=torch.full((500,), -50.0)))
    assert objective(scene, nothing, PAPER_EPSILON, reference=False).loss_and_slope(0, 0.1) == (1.0, 0.0)


def test_a_soft_objective_is_the_loss_of_the_blurred_render() -> None:
    scene, model = spiral(0, RIG, 1.3)
    pictures = replace(Pictures.of(Problem.of(scene, model, GLOBAL)), blur_px=1.5)
    sharp, softer, theta = replace(pictures, blur_px=0.0).objective(), pictures.objective(), math.log(1.2)
    gray = blurred(sharp.gray(2, torch.tensor(theta, dtype=torch.float64))[None], 1.5)[0]
    image = torch.from_numpy(pictures.thermal[pictures.frames[2].name]).double()
    expected = NgfPyramid.of(image, settings=pictures.edge_loss()).loss(gray.double())
    assert softer.loss(2, theta) == pytest.approx(expected, abs=1e-5)
    np.testing.assert_allclose(sharp.loss_over_blur(2, theta, (0.0, 1.5)), [sharp.loss(2, theta), expected], atol=1e-5)
    assert abs(expected - sharp.loss(2, theta)) > 1e-3
    h = 1e-3
    secant = (softer.loss(2, theta + h) - softer.loss(2, theta - h)) / (2 * h)
    assert softer.evaluate(2, theta).slope == pytest.approx(secant, rel=0.1, abs=0.01)
    assert loss_and_slope_in_reverse(softer, 2, theta)[1] == pytest.approx(softer.evaluate(2, theta).slope, rel=0.02, abs=2e-3)
