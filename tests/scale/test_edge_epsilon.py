"""Which gradients are edges: ε from the pictures."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.helpers.scale_scenes import RIG, assembled, photographs, posts

from rtgs.images.filters import GRAY_WEIGHTS
from rtgs.scale.edge_epsilon import mean_gradients, model_error


def test_mean_gradients_are_those_of_valid_pixels_level_by_level() -> None:
    ramp = torch.arange(40.0).repeat(24, 1) * 0.01
    mask = np.ones((24, 40), bool)
    np.testing.assert_allclose(mean_gradients([ramp, 3 * ramp], mask, 3), [8 * 0.02, 16 * 0.02, 32 * 0.02], rtol=1e-4)
    spoiled, mask[10, 7] = ramp.clone(), False
    spoiled[10, 7] = float("nan")
    np.testing.assert_allclose(mean_gradients([spoiled], mask, 2), [0.08, 0.16], rtol=1e-4)
    assert mean_gradients([torch.zeros(24, 40)], mask, 1) == (1e-6,)


def test_the_models_error_is_what_photographs_show_of_it() -> None:
    scene, model = posts()
    exact = assembled([scene.world_from_rgb["001"]], [scene.frames[1].thermal], RIG, photographs(scene, model, 0.0)[1:2])
    assert model_error(exact, model, exact.frames[0]).abs().max() < 1e-5
    frame = scene.frames[1]
    noisy = model_error(scene, model, frame)
    assert noisy.shape == (48, 56)
    expected = 0.02 * math.sqrt(sum(w * w for w in GRAY_WEIGHTS))  # the noise of `photographs`, made gray
    assert float(noisy.std()) == pytest.approx(expected, rel=0.05)
    coarse = replace(scene, capture=replace(scene.capture, rig=replace(RIG, thermal=replace(RIG.thermal, fl_x=30.0, fl_y=30.0))))
    assert model_error(coarse, model, frame).shape == (24, 28)  # the thermal camera's pixels per degree
