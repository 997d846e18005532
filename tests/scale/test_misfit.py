"""How far the edges miss each other beside the scale, and what it does to the interval and the verdict."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.helpers.scale_scenes import FORWARDS, GLOBAL, RIG, posts, spiral, with_rig

from rtgs.config import RgbConfig, SfmConfig, SynthConfig
from rtgs.io.capture import load_capture
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.records.rig import Rig
from rtgs.rgb.train import fit_rgb
from rtgs.scale import estimate_scale
from rtgs.sfm.poses import run_sfm
from rtgs.synthetic import write_capture

pytestmark = pytest.mark.thorough


def turned(rig: Rig, degrees: float, axis: list[float]) -> Rig:
    """The rig with a rotation that is wrong about one of the thermal camera's axes."""
    pose = rig.rgb_from_thermal
    wrong = rotation_from_axis_angle(math.radians(degrees) * np.array(axis))
    return replace(rig, rgb_from_thermal=SE3(pose.rotation @ wrong, pose.translation))


def test_edges_that_meet_have_no_misfit() -> None:
    estimate = estimate_scale(*posts(), GLOBAL)
    assert 0.0 <= estimate.misfit_px < 0.05 and estimate.status == "ok"


@pytest.mark.parametrize("degrees", [0.5, 1.0])
def test_a_turn_across_the_baseline_is_measured_in_pixels(degrees: float) -> None:
    scene, model = posts()
    across = np.cross([0.0, 0.0, 1.0], [RIG.rgb_from_thermal.translation[1], -RIG.rgb_from_thermal.translation[0], 0.0])
    axis = (across / np.linalg.norm(across)).tolist()  # about the baseline: the picture moves at right angles to the flow
    estimate = estimate_scale(with_rig(scene, turned(RIG, degrees, axis)), model, GLOBAL)
    moved = math.radians(degrees) * RIG.thermal.fl_x
    assert estimate.misfit_px == pytest.approx(moved, rel=0.5)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("rig", [RIG, FORWARDS])
def test_the_interval_of_a_wrong_rotation_is_as_wide_as_its_error(rig: Rig, seed: int) -> None:
    """Frames all err alike under a wrong rotation, so that their scatter says nothing of it."""
    scene, model = spiral(seed, rig, 2.0)
    axis = np.random.default_rng(seed).normal(size=3)
    estimate = estimate_scale(with_rig(scene, turned(rig, 0.8, (axis / np.linalg.norm(axis)).tolist())), model, GLOBAL)
    if estimate.status != "ok":
        assert estimate.reason
        return
    assert estimate.ci95 is not None
    lo, hi = (math.log(end) for end in estimate.ci95)
    assert abs(math.log(2.0) - (lo + hi) / 2) < 1.5 * (hi - lo) / 2


def test_a_refined_rotation_has_no_misfit() -> None:
    scene, model = posts()
    wrong = with_rig(scene, turned(RIG, 0.5, [1.0, 0.0, 0.0]))
    estimate = estimate_scale(wrong, model, replace(GLOBAL, refine=("rotation",)))
    assert estimate.misfit_px == 0.0 and estimate.status == "ok" and estimate.disagreeing == ()
    assert estimate.sfm_per_metre == pytest.approx(1.0, rel=0.05)


def test_a_model_that_has_hardly_been_trained_carries_no_scale(tmp_path: Path) -> None:
    """64 × 64 pixels, 12 frames and 200 steps: the model is a blob, and its best scale is half the true one."""
    config = SynthConfig(scene="lego", size=64, frames=12, thermal_clean=False)
    truth = write_capture(tmp_path / "capture", config).sfm_per_metre
    scene = run_sfm(load_capture(tmp_path / "capture"), SfmConfig())
    estimate = estimate_scale(scene, fit_rgb(scene, RgbConfig(steps=200)))
    assert abs(math.log(estimate.sfm_per_metre / truth)) > 0.3  # else the test would show nothing
    assert estimate.status == "unobservable" and estimate.ci95 is None and estimate.reason
