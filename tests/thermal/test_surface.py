"""What several views agree about at one place of a surface."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.helpers.spotted_wall import on_the_wall, spotted_wall
from tests.helpers.wall_scene import THERMAL, TRUTH

from rtgs.records.gaussians import Gaussians
from rtgs.thermal.settings import FollowSettings
from rtgs.thermal.surface import Footprints, Surface


def surface(valid: torch.Tensor | None = None, **settings: float) -> Surface:
    scene, rgb = spotted_wall()
    poses = [scene.thermal_from_world(f.name, TRUTH) for f in scene.train_frames]
    valid = torch.ones(THERMAL.height, THERMAL.width) if valid is None else valid
    return Surface.of(rgb.gaussians, THERMAL, poses, valid, rgb.settings, FollowSettings(**settings))  # type: ignore[arg-type]


def places() -> list[tuple[np.ndarray, np.ndarray]]:
    scene = spotted_wall()[0]
    return [on_the_wall(scene.world_from_thermal(f.name, TRUTH)) for f in scene.train_frames]


def test_depth_of_a_wall() -> None:
    """A wall across the optical axis is as deep everywhere."""
    depth = surface().depth
    inside = depth[:, 10:-10, 10:-10]
    assert (inside > 0).all() and np.allclose(inside, TRUTH, rtol=0.01)


def test_what_all_show_at_one_place_is_agreed_upon() -> None:
    shown = [torch.from_numpy(np.exp(-0.5 * (x**2 + y**2) / 0.02**2)).float() for x, y in places()]
    agreed = surface().consensus(shown)
    for image, found in zip(shown, agreed, strict=True):
        warm = image.numpy() > 0.3
        assert np.allclose(found[warm], image.numpy()[warm], atol=0.1)


def test_what_one_shows_is_not_nor_is_noise() -> None:
    rng = np.random.default_rng(0)
    noise = [torch.from_numpy(0.1 * rng.standard_normal((THERMAL.height, THERMAL.width))).float() for _ in places()]
    agreed = surface().consensus(noise)
    assert (agreed == 0).mean() > 0.8
    noise[3][10:25, 10:25] += 5.0
    assert np.abs(surface().consensus(noise)).max() < 1.0


def test_fewer_views_than_wanted_agree_about_nothing() -> None:
    shown = [torch.ones(THERMAL.height, THERMAL.width) for _ in places()]
    assert (surface(neighbours=3, fewest_views=4).consensus(shown) == 0).all()
    assert (surface(neighbours=3, fewest_views=3).consensus(shown) == 1).any()


def test_masked_pixels_have_no_part() -> None:
    valid = torch.ones(THERMAL.height, THERMAL.width)
    valid[:, :20] = 0.0
    shown = [torch.where(valid > 0, torch.ones(()), torch.tensor(100.0)) for _ in places()]
    agreed = surface(valid).consensus(shown)
    assert (agreed[:, :, :20] == 0).all() and agreed.max() == 1.0


@pytest.mark.parametrize("size", [0.002, 0.03])
def test_means_over_footprints(size: float) -> None:
    """Of a map that grows along the wall, a Gaussian's mean is the value at its centre, whatever its size."""
    maps = np.stack([x for x, _ in places()]).astype(np.float32)
    centres = torch.tensor([[0.02, 0.01, TRUTH], [-0.03, 0.02, TRUTH], [0.0, 0.0, 50.0]])
    gaussians = Gaussians(
        centres, torch.tensor([[1.0, 0, 0, 0]]).repeat(3, 1), torch.full((3, 3), size).log(), torch.zeros(3), torch.zeros(3, 1, 1)
    )
    found = Footprints(surface(), maps).means(gaussians)
    assert torch.allclose(found[:2], centres[:2, 0], atol=0.01) and float(found[2]) == 0.0
