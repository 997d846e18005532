"""Thermal images as the search compares them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.helpers.scale_scenes import FORWARDS, GLOBAL, RIG, cloud, drawn, orbit, spiral

from rtgs.losses.edge_loss import EdgeLoss
from rtgs.losses.ngf import NgfPyramid
from rtgs.models import RgbModel
from rtgs.renderer import RenderSettings
from rtgs.scale import Comparison
from rtgs.scale.problem import Problem
from rtgs.scale.resampling import curve_minimum
from rtgs.scale.thermal_targets import Pictures


def test_an_epsilon_of_the_size_of_edges_rewards_larger_edges() -> None:
    # Forwards is where edges grow. The thermal images are the model's own, so the minimum belongs at s = 1.
    model = RgbModel(cloud(1), torch.full((3,), 0.4), RenderSettings(near_plane=0.05))
    scene, thetas = drawn(model, orbit(), FORWARDS, 1.0), np.linspace(-0.1, 0.1, 21)
    pictures = Pictures.of(Problem.of(scene, model, GLOBAL))
    assert pictures.renders == 6
    off = []
    for epsilon in (pictures.render_epsilon, pictures.epsilon):
        loss = replace(pictures, render_epsilon=epsilon).objective()
        curves = np.array([[loss.loss(i, t) for t in thetas] for i in range(len(loss.frames))])
        off.append(abs(curve_minimum(thetas, curves.mean(axis=0))))
    assert off[0] < 0.01 and off[1] > 0.02


def test_a_comparison_may_count_only_what_the_model_covers() -> None:
    scene, model = spiral(0, RIG, 1.3)
    of = {
        c: Pictures.of(Problem.of(scene, model, replace(GLOBAL, level_weights=(1.0,)), Comparison(covered=c)))
        for c in (False, True)
    }
    theta, frame = math.log(1.2), scene.train_frames[2]
    index = scene.train_frames.index(frame)
    whole, covered = (of[c].objective() for c in (False, True))
    masks = of[True].masks
    assert masks is not None
    mask = masks[frame.name]
    assert 0.05 < mask.mean() < 0.95
    target = NgfPyramid.of(
        torch.from_numpy(of[True].thermal[frame.name]).double(),
        torch.from_numpy(mask),
        EdgeLoss((1.0,), of[True].epsilon[0], of[True].render_epsilon[0], per_edge=True),
    )
    gray = covered.gray(index, torch.tensor(theta, dtype=torch.float64)).double()
    assert covered.loss(index, theta) == pytest.approx(float(target(gray)), abs=1e-5)
    assert abs(covered.loss(index, theta) - whole.loss(index, theta)) > 1e-3
