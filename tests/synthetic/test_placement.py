"""Features stand where enough views see them, apart from each other, and are as large in the images as their name says."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from rtgs.base.errors import RtgsError
from rtgs.config import FEATURES
from rtgs.records.capture import Split
from rtgs.synthetic import GroundTruth, SynthConfig, compiled_scene
from rtgs.synthetic.capture import draw_truth
from rtgs.synthetic.placement import FEWEST_VIEWS

pytest.importorskip("embreex")
pytestmark = pytest.mark.thorough

CONFIG = SynthConfig(scene="hotdog", frames=50, size=400, seed=1, features=FEATURES)


@pytest.fixture(scope="module")
def truth() -> GroundTruth:
    return draw_truth(CONFIG)


def test_spots_of_all_sizes_hot_and_cold_lines_and_a_rectangle(truth: GroundTruth) -> None:
    spots = {(f.size_px, f.sign) for f in truth.features if f.kind == "spot"}
    assert spots == {(size, sign) for size in (2, 3, 5, 8) for sign in (1, -1)}
    assert {f.size_px for f in truth.features if f.kind == "line"} == {2, 3}
    assert [f.sign for f in truth.features if f.kind == "rectangle"] == [1]
    assert all(f.peak_c - f.surroundings_c == pytest.approx(15 * f.sign) for f in truth.features)


def test_every_feature_is_seen_whole_by_enough_views(truth: GroundTruth) -> None:
    held_out = Split().held_out_names(list(truth.world_from_rgb))
    model = compiled_scene("hotdog")
    for feature in truth.features:
        training = [name for name in feature.views if name not in held_out]
        assert len(training) >= FEWEST_VIEWS and len(feature.views) > len(training)
        at = np.array(feature.position_m)
        for name in feature.views:
            pose = truth.world_from_thermal[name]
            ray = (at - pose.translation) / np.linalg.norm(at - pose.translation)
            hit = model.hits(pose.translation[None], ray[None]).surface
            np.testing.assert_allclose(hit.world[0], at, atol=1e-6)
            assert hit.part[0] == feature.part
            x, y = truth.rig.thermal.project(pose.inverse().apply(at))
            assert 0 < x < CONFIG.size and 0 < y < CONFIG.size


def test_features_do_not_touch(truth: GroundTruth) -> None:
    for a, b in combinations(truth.features, 2):
        distance = np.linalg.norm(np.array(a.position_m) - b.position_m)
        assert distance > 0.5 * (a.length_m + b.length_m) + 0.5 * (a.fwhm_m + b.fwhm_m)


def test_widths_in_metres_are_those_of_pixels_at_the_median_distance(truth: GroundTruth) -> None:
    for feature in truth.features:
        depths = [truth.world_from_thermal[n].inverse().apply(np.array(feature.position_m))[2] for n in feature.views]
        pixels = feature.fwhm_m / np.array(depths) * truth.rig.thermal.fl_x
        assert np.median(pixels) == pytest.approx(
            feature.size_px, rel=0.15
        )  # the outline may be seen by fewer views than the centre


def test_the_seed_draws_them(truth: GroundTruth) -> None:
    assert draw_truth(CONFIG).features == truth.features
    other = draw_truth(replace(CONFIG, seed=2)).features
    assert not {f.position_m for f in other} & {f.position_m for f in truth.features}
    assert {f.kind for f in draw_truth(replace(CONFIG, features=("lines",))).features} == {"line"}


def test_too_few_frames_are_refused() -> None:
    with pytest.raises(RtgsError, match="8 training views"):
        draw_truth(replace(CONFIG, frames=6))
