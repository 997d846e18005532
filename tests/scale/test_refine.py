"""Joint refinement: recovery of known errors, and what the images cannot decide."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.scale_scenes import RIG, STATED, STD, assembled, sequence, with_rig

from rtgs.base.errors import RtgsError
from rtgs.config import ScaleConfig
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.records.rig import CalibrationStd, Rig
from rtgs.scale import estimate_scale
from rtgs.scale.refine import check_refinable

Change = Callable[[Rig], Rig]


def turned(rig: Rig) -> Rig:
    turn = rotation_from_axis_angle([0.006, -0.008, 0.01])
    return replace(rig, rgb_from_thermal=SE3(rig.rgb_from_thermal.rotation @ turn, rig.rgb_from_thermal.translation))


def tilted(rig: Rig) -> Rig:
    t = rig.rgb_from_thermal.translation
    return replace(rig, rgb_from_thermal=SE3(rig.rgb_from_thermal.rotation, rotation_from_axis_angle([0.02, 0.03, 0.06]) @ t))


def zoomed(rig: Rig) -> Rig:
    return replace(rig, thermal=replace(rig.thermal, fl_x=1.03 * rig.thermal.fl_x, fl_y=1.03 * rig.thermal.fl_y))


def distance(a: Rig, b: Rig) -> dict[str, float]:
    """How far two rigs are apart, in standard deviations of the prior."""
    ta, tb = a.rgb_from_thermal.translation, b.rgb_from_thermal.translation
    turn = a.rgb_from_thermal.rotation.T @ b.rgb_from_thermal.rotation
    return {
        "rotation": math.acos(min(1.0, (np.trace(turn) - 1) / 2)) / STD.rotation_rad,
        "baseline-direction": float(np.linalg.norm(ta - tb)) / a.baseline_m / STD.baseline_direction,
        "focal": abs(a.thermal.fl_x / b.thermal.fl_x - 1) / STD.thermal_focal,
        "time-offset": abs(a.time_offset - b.time_offset) * math.sqrt(12),
    }


@pytest.mark.thorough
@pytest.mark.parametrize(
    "what, error, offset, left",
    [
        ("rotation", turned, 0.0, 0.25),
        ("baseline-direction", tilted, 0.0, 0.35),  # one of its two sides is hardly seen
        ("focal", zoomed, 0.0, 0.05),
        ("time-offset", lambda rig: rig, 0.3, 0.25),
    ],
)
def test_a_known_error_is_recovered(what: str, error: Change, offset: float, left: float) -> None:
    scene, model = sequence(offset)
    off = with_rig(scene, error(STATED))
    plain, refined = (estimate_scale(off, model, ScaleConfig(solver="global", init=1.0, refine=names)) for names in ((), (what,)))
    assert abs(math.log(refined.sfm_per_metre)) < max(0.01, 0.5 * abs(math.log(plain.sfm_per_metre)))
    before = distance(off.rig, replace(STATED, time_offset=offset))[what]
    after = distance(refined.refined_scene(off).rig, replace(STATED, time_offset=offset))[what]
    assert before > 0.9 and after < left * before
    assert refined.refinement is not None and refined.refinement.before == plain.sfm_per_metre
    assert refined.ci95 is not None and refined.ci95[0] < 1.0 < refined.ci95[1]
    assert refined.refined_scene(off).rig.baseline_m == pytest.approx(off.rig.baseline_m, rel=1e-9)  # never refined


def test_what_the_images_cannot_decide_is_said() -> None:
    scene, model = sequence()
    sure = replace(RIG, calibration_std=CalibrationStd(baseline_direction=1e-4, thermal_focal=0.05, baseline_length=0.04))
    estimate = estimate_scale(
        with_rig(scene, sure), model, ScaleConfig(solver="global", init=1.0, refine=("baseline-direction", "focal"))
    )
    assert estimate.refinement is not None
    assert [f.name for f in estimate.refinement.freedoms if not f.decided] == ["baseline direction, a", "baseline direction, b"]
    focal = estimate.refinement.freedoms[-1]
    assert focal.decided and focal.std < 1.0 and focal.prior_std == pytest.approx(5.0)  # per cent
    # The length is not refined: its uncertainty is the scale's.
    assert estimate.calibration_std_log == pytest.approx(0.04)
    assert estimate.std_log is not None and estimate.std_log > 0.04


@pytest.mark.thorough
def test_what_is_held_widens_the_interval() -> None:
    scene, model = sequence()
    refine = ScaleConfig(solver="global", init=1.0, refine=("focal",))
    loose, tight = (
        estimate_scale(with_rig(scene, replace(RIG, calibration_std=std)), model, refine)
        for std in (CalibrationStd(rotation_rad=0.01), CalibrationStd())
    )
    assert loose.sfm_per_metre == pytest.approx(tight.sfm_per_metre, rel=1e-6)
    assert tight.calibration_std_log == 0.0
    assert loose.calibration_std_log is not None and loose.calibration_std_log > 0.01
    assert loose.std_log is not None and tight.std_log is not None
    assert loose.std_log == pytest.approx(math.hypot(tight.std_log, loose.calibration_std_log), rel=1e-6)


def test_frames_in_no_order_have_no_time() -> None:
    scene, _ = sequence()
    check_refinable(scene, scene.train_frames, ("time-offset",))
    names, poses = list(scene.world_from_rgb), list(scene.world_from_rgb.values())
    order = np.random.default_rng(0).permutation(len(names))
    shuffled = replace(scene, world_from_rgb={n: poses[k] for n, k in zip(names, order, strict=True)})
    with pytest.raises(RtgsError, match=r"time-offset: the camera does not move smoothly .* order of time"):
        check_refinable(shuffled, scene.train_frames, ("time-offset",))
    apart = replace(scene, world_from_rgb=dict(list(scene.world_from_rgb.items())[::2]))
    with pytest.raises(RtgsError, match="fewer than three frames"):
        check_refinable(apart, scene.train_frames, ("time-offset",))
    with pytest.raises(RtgsError, match="3 training frames are used"):
        estimate_scale(scene, sequence()[1], ScaleConfig(max_frames=3, refine=("focal",)))


def test_nothing_is_refined_about_a_scale_that_is_none() -> None:
    scene, model = sequence()
    blank = with_rig(scene, RIG)
    flat = assembled(
        list(blank.world_from_rgb.values()), [np.full((RIG.thermal.height, RIG.thermal.width), 20.0, np.float32)] * 16, RIG
    )
    estimate = estimate_scale(flat, model, ScaleConfig(solver="global", refine=("focal",)))
    assert estimate.status == "unobservable" and estimate.refinement is None and "not refined" in estimate.reason
