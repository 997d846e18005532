"""A rig from the capture itself: found where the images tell it, and said where they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.scale_scenes import RIG, sequence, spiral
from tests.helpers.unknown_rig import apart_deg, far_wall, unknown

from rtgs.base.errors import RtgsError
from rtgs.config import ScaleConfig
from rtgs.scale import estimate_scale

pytestmark = pytest.mark.thorough


def test_rotation_focal_length_and_baseline_are_found_without_a_start() -> None:
    scene, model = spiral(1, RIG, 1.0)
    found = estimate_scale(unknown(scene, turned=(5.0, -6.0, 4.0), baseline_m=RIG.baseline_m), model)
    rig, calibration = found.refined_scene(scene).rig, found.calibration
    assert calibration is not None and calibration.baseline_decided and found.status == "ok"
    assert apart_deg(rig, RIG) < 0.1
    assert abs(rig.thermal.fl_x / RIG.thermal.fl_x - 1) < 0.005
    assert rig.baseline_m == pytest.approx(RIG.baseline_m) and found.baseline_m == RIG.baseline_m
    assert found.ci95 is not None and found.ci95[0] < 1.0 < found.ci95[1]
    assert found.sfm_per_metre == pytest.approx(1.0, rel=0.02)
    assert rig.start is None


def test_without_a_length_the_rig_is_found_and_no_metres_are_claimed() -> None:
    scene, model = spiral(1, RIG, 3.0)
    found = estimate_scale(unknown(scene, turned=(1.0, -2.0, 1.0)), model)
    assert found.status == "unobservable" and "baseline_m" in found.reason and found.baseline_m is None
    assert found.calibration is not None and found.calibration.baseline_decided
    assert found.sfm_per_metre == pytest.approx(3.0 * RIG.baseline_m, rel=0.03)
    assert apart_deg(found.refined_scene(scene).rig, RIG) < 0.2


def test_what_the_images_tell_badly_has_a_wide_interval_that_holds_the_truth() -> None:
    """A ball seen from one side: going forwards looks like zooming."""
    scene, model = sequence()
    found = estimate_scale(unknown(scene, turned=(5.0, -6.0, 4.0), baseline_m=scene.rig.baseline_m), model)
    assert found.std_log is not None and found.ci95 is not None and found.refinement is not None
    assert found.std_log > 0.1 and found.ci95[0] < 1.0 < found.ci95[1]
    freedoms = {f.name: f for f in found.refinement.freedoms}
    true = {"rotation about x": -5.0, "rotation about y": 6.0, "rotation about z": -4.0, "thermal focal length": 100 / 0.95 - 100}
    for name, value in true.items():
        assert abs(freedoms[name].mean - value) < 3 * freedoms[name].std + 0.3


def test_a_far_wall_tells_rotation_and_focal_length_but_no_baseline() -> None:
    scene, model = far_wall(60.0)
    found = estimate_scale(unknown(scene, turned=(2.0, -3.0, 2.0), baseline_m=0.2), model)
    assert found.calibration is not None and not found.calibration.baseline_seen
    assert found.status == "unobservable" and "not the baseline" in found.reason and found.ci95 is None
    rig = found.refined_scene(scene).rig
    assert apart_deg(rig, scene.rig) < 0.4  # 0.2 m at 60 m are 0.19°
    assert abs(rig.thermal.fl_x / scene.rig.thermal.fl_x - 1) < 0.005


def test_refining_what_is_found_anyway_is_refused() -> None:
    scene, model = sequence()
    with pytest.raises(RtgsError, match=r"rig\.json gives no calibration"):
        estimate_scale(unknown(scene, turned=(0.0, 0.0, 0.0)), model, ScaleConfig(refine=("rotation",)))


def test_pictures_of_something_else_are_no_calibration() -> None:
    scene, model = sequence()
    rng = np.random.default_rng(0)
    shape = scene.train_frames[0].thermal.shape
    frames = tuple(f.with_thermal(rng.normal(size=shape).astype(np.float32)) for f in scene.capture.frames)
    found = estimate_scale(
        unknown(replace(scene, capture=replace(scene.capture, frames=frames)), turned=(0.0, 0.0, 0.0), baseline_m=0.2), model
    )
    assert found.status != "ok"
