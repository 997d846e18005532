"""How soft the thermal images are, and which frames disagree."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.helpers.scale_scenes import GLOBAL, RIG, assembled, facing_walls, soft, spiral

from rtgs.scale import Comparison, estimate_scale


@pytest.mark.thorough
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_soft_lens_is_noticed_and_allowed_for(seed: int) -> None:
    scene, model = spiral(seed, RIG, 1.3)
    sharp = estimate_scale(scene, model, GLOBAL)
    softer = estimate_scale(soft(scene, 2.0), model, GLOBAL)
    assert sharp.blur_px == 0.0 and 1.4 <= softer.blur_px <= 2.8
    assert softer.status == "ok" and softer.ci95 is not None and sharp.ci95 is not None
    assert softer.ci95[0] < 1.3 < softer.ci95[1]
    assert math.log(softer.ci95[1] / softer.ci95[0]) > 1.5 * math.log(sharp.ci95[1] / sharp.ci95[0])
    assert abs(softer.sfm_per_metre / 1.3 - 1) < 0.02


@pytest.mark.thorough
def test_renders_as_soft_as_the_lens_halve_the_error() -> None:
    errors = np.zeros((3, 2))
    for seed in range(3):
        scene, model = spiral(seed, RIG, 1.3)
        for column in range(2):
            found = estimate_scale(soft(scene, 2.0), model, GLOBAL, comparison=Comparison(match_blur=column == 0))
            errors[seed, column] = abs(found.sfm_per_metre / 1.3 - 1)
    assert errors[:, 0].mean() < 0.6 * errors[:, 1].mean()


@pytest.mark.thorough
def test_a_wrong_pair_is_named() -> None:
    # Two frames of a camera that has moved by 2.6 px between them are swapped; the scale moves the picture by 6.4 px.
    scene, model = facing_walls(2.0, None, 1.0, 15)
    swapped = {"003": "005", "005": "003"}
    images = {f.name: f.thermal for f in scene.frames}
    poses = [scene.world_from_rgb[f.name] for f in scene.frames]
    wrong = assembled(
        poses, [images[swapped.get(f.name, f.name)] for f in scene.frames], scene.rig, [f.rgb for f in scene.frames]
    )
    assert estimate_scale(scene, model, GLOBAL).disagreeing == ()
    estimate = estimate_scale(wrong, model, GLOBAL)
    assert set(estimate.disagreeing) == set(swapped)
    assert estimate.sfm_per_metre == pytest.approx(1.0, rel=0.03)
