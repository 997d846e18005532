"""The loss over scale and calibration together: its derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from tests.helpers.scale_scenes import STATED, in_float64, sequence

from rtgs.config import REFINABLE
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.models import RgbModel
from rtgs.records.scene import Scene
from rtgs.scale import Objective
from rtgs.scale.posterior import positive
from rtgs.scale.progress import RenderProgress
from rtgs.scale.rig_loss import RigLoss
from rtgs.scale.rig_motion import motions


def two_frames(scene: Scene, model: RgbModel, reduction: int = 1) -> Objective:
    return Objective(scene, model, scene.train_frames[3:5], EdgeLoss((1.0, 1.0), epsilon=0.1), reduction)


@pytest.mark.parametrize("reduction", [1, 2])
def test_the_gradient_is_the_losses_own(reduction: int) -> None:
    scene, model = sequence()
    loss, joint = two_frames(scene, model, reduction), RigLoss(scene, motions(STATED, REFINABLE), RenderProgress(None))
    x = np.array([0.03, 0.3, -0.2, 0.1, 0.4, -0.3, 0.5, 0.2])
    here = joint.evaluate(loss, range(2), x)
    np.testing.assert_array_equal(joint.gradient(loss, range(2), x), here.gradient)
    assert here.gradients.shape == (2, 8) and not np.allclose(here.gradients[0], here.gradients[1], rtol=0.01)
    # The 1/255 cut-off jumps; a tenth of a pixel passes over its steps.
    steps = 0.1 / joint.pixels(x, model.gaussians)
    measured = []
    for e, h in zip(np.eye(8), steps, strict=True):
        after, before = (joint.evaluate(loss, range(2), x + sign * h * e).losses.mean() for sign in (1, -1))
        measured.append((after - before) / (2 * h))
    scaled = here.gradient * steps
    np.testing.assert_allclose(scaled, np.array(measured) * steps, atol=0.05 * np.abs(scaled).max())
    assert (np.abs(scaled) > 1e-6).all()


def test_both_back_ends_have_the_same_derivatives() -> None:
    scene, model = sequence()
    joint, x = (
        RigLoss(scene, motions(STATED, REFINABLE), RenderProgress(None)),
        np.array([0.03, 0.3, -0.2, 0.1, 0.4, -0.3, 0.5, 0.2]),
    )
    fast, slow = (joint.evaluate(two_frames(scene, m, 2), range(1), x) for m in (model, in_float64(model)))
    assert fast.losses[0] == pytest.approx(slow.losses[0], rel=1e-5)
    np.testing.assert_allclose(fast.gradient, slow.gradient, atol=1e-3 * np.abs(slow.gradient).max())
    np.testing.assert_allclose(fast.gauss_newton, slow.gauss_newton, atol=1e-3 * np.abs(slow.gauss_newton).max())


def test_the_hessian_is_the_gradients_slope() -> None:
    scene, model = sequence()
    loss = two_frames(scene, model)
    joint, x = RigLoss(scene, motions(STATED, REFINABLE), RenderProgress(None)), np.zeros(8)
    hessian = joint.hessian(loss, range(2), x, 0.3 / joint.pixels(x, model.gaussians))
    np.testing.assert_array_equal(hessian, hessian.T)
    point = joint.evaluate(loss, range(2), x)
    # Near the truth, with pictures that agree, Gauss–Newton's matrix is close.
    assert np.linalg.norm(hessian - point.gauss_newton) < 0.6 * np.linalg.norm(hessian)
    assert (np.linalg.eigvalsh(positive(hessian, point.gauss_newton)) > 0).all()


def test_the_first_entry_is_the_objectives_own_slope() -> None:
    scene, model = sequence()
    loss, joint = two_frames(scene, model), RigLoss(scene, motions(STATED, REFINABLE), RenderProgress(None))
    point, expected = joint.evaluate(loss, range(2), np.array([0.03, *np.zeros(7)])), [loss.evaluate(i, 0.03) for i in range(2)]
    np.testing.assert_allclose(point.losses, [e.loss for e in expected], rtol=1e-6)
    np.testing.assert_allclose(point.gradients[:, 0], [e.slope for e in expected], rtol=1e-4)
    assert point.gauss_newton[0, 0] == pytest.approx(np.mean([e.curvature for e in expected]), rel=1e-4)
