"""What training starts from."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from tests.helpers.ball_scene import QUICK, held_out_psnr, synthetic
from tests.helpers.scene_record import NO_POINTS, altered

from rtgs.maths.sh import C0
from rtgs.rgb.initial import initial_background, initial_gaussians, starting_points
from rtgs.rgb.train import Training, fit_rgb


def test_without_points_it_starts_from_random_ones() -> None:
    scene = replace(synthetic(), points=NO_POINTS)
    config = replace(QUICK, random_points=250)
    training = Training(scene, config)
    means = training.optimizer.parameters["means"].detach().double().numpy()
    assert len(means) == 250
    in_view = np.zeros(250, bool)
    for frame in scene.train_frames:
        x, y, z = scene.rgb_from_world(frame.name).apply(means).T
        u, v = 44 * x / z + 20, 44 * y / z + 20
        in_view |= (z > 0) & (u > 0) & (u < 40) & (v > 0) & (v < 40)
    assert in_view.all()
    assert held_out_psnr(scene, fit_rgb(scene, config)) > held_out_psnr(scene, fit_rgb(scene, replace(config, steps=1))) + 1.0
    assert len(Training(scene, replace(config, random_points=5000)).gaussians()) == config.densify.max_gaussians


def test_the_background_starts_at_the_median_border_of_the_training_frames() -> None:
    scene = synthetic()
    grays = {f.name: 0.1 * (k + 1) for k, f in enumerate(scene.train_frames)} | {f.name: 1.0 for f in scene.held_out_frames}
    flat = altered(scene, rgb={name: np.full((40, 40, 3), gray, np.float32) for name, gray in grays.items()})
    torch.testing.assert_close(initial_background(flat, QUICK), torch.full((3,), 0.45))  # of 0.1, 0.2, …, 0.8


def test_points_become_gaussians_of_their_colour_and_spacing() -> None:
    xyz = np.stack(np.meshgrid(*[np.arange(6.0)] * 3), -1).reshape(-1, 3)
    rgb = np.random.default_rng(0).random((len(xyz), 3)).astype(np.float32)
    start = initial_gaussians(xyz, rgb, 2)
    assert start.sh.shape == (216, 9, 3)
    torch.testing.assert_close(start.sh[:, 0] * C0 + 0.5, torch.from_numpy(rgb))
    torch.testing.assert_close(start.log_scales, torch.zeros(216, 3))  # neighbours at distance 1
    torch.testing.assert_close(torch.sigmoid(start.opacity_logits), torch.full((216,), 0.1))
    scaled = initial_gaussians(xyz * 1e-3, rgb, 2)
    torch.testing.assert_close(scaled.log_scales, torch.full((216, 3), math.log(1e-3)))
    for few in (1, 2, 3):
        assert torch.isfinite(initial_gaussians(xyz[:few], rgb[:few], 0).log_scales).all()
    assert torch.isfinite(initial_gaussians(np.zeros((9, 3)), rgb[:9], 0).log_scales).all()  # duplicates


def test_more_points_than_the_budget_are_thinned_at_random() -> None:
    scene = synthetic()
    xyz, rgb = starting_points(scene, QUICK, 60)
    index = [int(np.flatnonzero((scene.points.xyz == point).all(1))[0]) for point in xyz]
    assert len(set(index)) == 60 and index != sorted(index)
    np.testing.assert_array_equal(rgb, scene.points.rgb[index])
    assert len(starting_points(scene, QUICK, 1000)[0]) == len(scene.points)
