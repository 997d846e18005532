"""Thermal geometry that follows the photographs shows what RGB does not, and leaves out what one photograph alone shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.helpers.scene_record import altered
from tests.helpers.spotted_wall import on_the_wall, shares_at_centres, spotted_wall, wall_celsius
from tests.helpers.thermal_scenes import SFM_PER_METRE, ring
from tests.helpers.wall_scene import THERMAL, TRUTH

from rtgs.config import ThermalConfig
from rtgs.models import ThermalModel
from rtgs.records.scene import Scene
from rtgs.thermal import fit_thermal, gaussian_temperatures
from rtgs.thermal.linear import fit_linear
from rtgs.thermal.settings import FollowSettings, LinearSettings

FROZEN, FOLLOW, REFINE = (ThermalConfig(geometry=geometry) for geometry in ("frozen", "follow", "refine"))
BOTH = pytest.mark.parametrize("config", [FOLLOW, REFINE], ids=["follow", "refine"])


def held_out_errors(scene: Scene, model: ThermalModel, *, spots: bool) -> list[np.ndarray]:
    """`[h, w]` for each held-out frame, against the temperatures without noise."""
    out = []
    for frame in scene.held_out_frames:
        world_from_thermal = scene.world_from_thermal(frame.name, TRUTH)
        out.append(model.render(THERMAL, world_from_thermal.inverse()) - wall_celsius(*on_the_wall(world_from_thermal), spots))
    return out


@BOTH
@pytest.mark.thorough
def test_spots_that_rgb_does_not_show(config: ThermalConfig) -> None:
    """Hot and cold ones, of 3.7 pixels; the frozen geometry, six pixels wide, shows nearly nothing of them."""
    scene, rgb = spotted_wall()
    frozen, follows = (fit_thermal(scene, rgb, TRUTH, c) for c in (FROZEN, config))
    before, after = shares_at_centres(scene, frozen), shares_at_centres(scene, follows)
    assert len(before) >= 8 and np.median(before) < 0.2
    assert np.median(after) > 0.9 and after.min() > 0.8
    decision = follows.decisions[-1]
    assert (decision.name, decision.choice) == ("geometry", "follows") and f"{len(follows.gaussians):,}" in decision.reason
    assert len(rgb.gaussians) < len(follows.gaussians) <= 3 * len(rgb.gaussians)
    known = gaussian_temperatures(scene, follows)
    assert known.temperature.shape == (len(follows.gaussians),) and np.isfinite(known.std).all()


@BOTH
@pytest.mark.thorough
def test_what_one_photograph_shows_alone_is_left_out(config: ThermalConfig) -> None:
    """A warm thing of 10 × 12 pixels in one training frame: held-out views of that place do not show it."""
    scene, rgb = spotted_wall()
    name, excess = scene.train_frames[4].name, 15.0
    image = scene.train_frames[4].thermal.copy()
    image[16:28, 18:28] += excess
    x, y = on_the_wall(scene.world_from_thermal(name, TRUTH))
    there = x[16:28, 18:28], y[16:28, 18:28]
    disturbed = altered(scene, thermal={f.name: image if f.name == name else f.thermal for f in scene.frames})
    with_it, without = (fit_thermal(s, rgb, TRUTH, config) for s in (disturbed, scene))
    shares = []
    for frame in scene.held_out_frames:
        world_from_thermal = scene.world_from_thermal(frame.name, TRUTH)
        x, y = on_the_wall(world_from_thermal)
        inside = (x > there[0].min()) & (x < there[0].max()) & (y > there[1].min()) & (y < there[1].max())
        a, b = (m.render(THERMAL, world_from_thermal.inverse()) for m in (with_it, without))
        shares.extend((a - b)[inside] / excess)
    assert len(shares) > 30 and abs(np.mean(shares)) < 0.05
    assert np.median(shares_at_centres(scene, with_it)) > 0.9


@BOTH
@pytest.mark.thorough
def test_without_spots_nothing_is_worse(config: ThermalConfig) -> None:
    scene, rgb = spotted_wall(spots=False)
    errors = [
        np.mean([np.abs(e).mean() for e in held_out_errors(scene, fit_thermal(scene, rgb, TRUTH, c), spots=False)])
        for c in (FROZEN, config)
    ]
    assert errors[1] <= 1.02 * errors[0]


@BOTH
@pytest.mark.thorough
def test_a_geometry_that_validation_frames_do_not_want_is_not_kept(config: ThermalConfig) -> None:
    """Nothing is missing in the ball of `ring`, whose geometry is exact: halves of its Gaussians only blur it."""
    scene, rgb, _ = ring()
    frozen, follows = (fit_thermal(scene, rgb, SFM_PER_METRE, c) for c in (FROZEN, config))
    decision = follows.decisions[-1]
    assert decision.choice == "frozen" and decision.reason.startswith("Tried and not kept")
    assert decision.error_before is not None and decision.error_after is not None
    for name, value in frozen.gaussians.tensors().items():
        assert torch.equal(value, follows.gaussians.tensors()[name])


def test_without_validation_frames_the_geometry_stays() -> None:
    scene, rgb = spotted_wall()
    few = replace(scene, capture=replace(scene.capture, frames=scene.capture.frames[1:3]))
    model = fit_thermal(few, rgb, TRUTH, FOLLOW)
    decision = model.decisions[-1]
    assert decision.choice == "frozen" and "too few" in decision.reason and len(model.gaussians) == len(rgb.gaussians)


@pytest.mark.thorough
def test_no_more_gaussians_than_allowed_nor_smaller_than_a_pixel() -> None:
    scene, rgb = spotted_wall()
    tight = LinearSettings(follow=FollowSettings(times=1.3))
    assert len(fit_linear(scene, rgb, TRUTH, FOLLOW, settings=tight).gaussians) <= 1.3 * len(rgb.gaussians)
    coarse = LinearSettings(follow=FollowSettings(finest_px=1000.0))
    model = fit_linear(scene, rgb, TRUTH, FOLLOW, settings=coarse)
    assert len(model.gaussians) == len(rgb.gaussians) and model.decisions[-1].choice == "frozen"


@BOTH
@pytest.mark.thorough
def test_threads_change_nothing(config: ThermalConfig) -> None:
    scene, rgb = spotted_wall()
    one, three = (fit_linear(scene, rgb, TRUTH, config, settings=LinearSettings(threads=threads)) for threads in (1, 3))
    assert torch.equal(one.gaussians.sh, three.gaussians.sh) and torch.equal(one.gaussians.means, three.gaussians.means)
