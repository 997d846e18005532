"""Joint refinement: derivatives along every freedom, recovery of known errors, what the images cannot decide, and who uses the result."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.scale.test_estimate import RIG, assembled, bumpy_ball, photographs

from rtgs.base.errors import RtgsError
from rtgs.config import REFINABLE, ScaleConfig
from rtgs.images.filters import GRAY_WEIGHTS
from rtgs.maths.geometry import SE3, look_at, rotation_from_axis_angle
from rtgs.maths.sh import C0
from rtgs.models import RgbModel
from rtgs.records.rig import CalibrationStd, Rig
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings, render
from rtgs.scale import Objective, ScaleEstimate, estimate_scale
from rtgs.scale.joint import Joint
from rtgs.scale.records import Counter
from rtgs.scale.refine import covariance, noise, positive
from rtgs.scale.unknowns import Unknown, check_refinable, unknowns

STD = CalibrationStd(baseline_direction=0.05, rotation_rad=0.01, thermal_focal=0.03)
STATED = replace(RIG, calibration_std=STD)
Change = Callable[[Rig], Rig]


@lru_cache(maxsize=8)
def sequence(time_offset: float = 0.0, n_frames: int = 16) -> tuple[Scene, RgbModel]:
    """A camera that walks around a textured ball; thermal images of inverted contrast, from the true rig, perhaps late. Truth: s = 1."""
    model = RgbModel(bumpy_ball(), torch.tensor([0.1, 0.3, 0.2]), RenderSettings(near_plane=0.05))
    gray = (0.5 + C0 * model.gaussians.sh[:, 0] @ torch.tensor(GRAY_WEIGHTS)).clamp(0, 1)
    hot = replace(model.gaussians, sh=(((1 - gray) ** 2 - 0.5) / C0)[:, None, None])
    poses = []
    for k in range(n_frames):
        angle = 0.1 * k
        poses.append(look_at([2.6 * math.cos(angle), 2.6 * math.sin(angle), 0.9 * math.sin(0.5 * k)], [0, 0, 0]))
    blank = np.zeros((RIG.thermal.height, RIG.thermal.width), np.float32)
    scene = assembled(poses, [blank] * n_frames, replace(RIG, time_offset=time_offset))
    images = []
    for frame in scene.frames:
        pose = scene.thermal_from_world(frame.name, 1.0)
        images.append(
            (20.0 + 15.0 * render(hot, RIG.thermal, pose, settings=model.settings).over(torch.tensor([0.9]))[..., 0]).numpy()
        )
    return assembled(poses, images, STATED, rgb=photographs(scene, model)), model


def with_rig(scene: Scene, rig: Rig) -> Scene:
    return replace(scene, capture=replace(scene.capture, rig=rig))


def everything(rig: Rig = STATED) -> list[Unknown]:
    return unknowns(rig, REFINABLE)


# --- the loss and its derivatives --------------------------------------------------------------------


def objective(scene: Scene, model: RgbModel, reduction: int = 1, *, reference: bool = False) -> Objective:
    gaussians = model.gaussians.to(torch.float64) if reference else model.gaussians
    settings = replace(model.settings, backend="reference") if reference else model.settings
    return Objective(
        scene, gaussians, model.background, settings, scene.train_frames[3:5], level_weights=(1.0, 1.0), epsilon=0.1, reduction=reduction
    )  # fmt: skip


@pytest.mark.parametrize("reduction", [1, 2])
def test_the_gradient_is_the_losses_own(reduction: int) -> None:
    scene, model = sequence()
    loss, joint = objective(scene, model, reduction), Joint(scene, everything(), Counter(None))
    x = np.array([0.03, 0.3, -0.2, 0.1, 0.4, -0.3, 0.5, 0.2])
    here = joint.evaluate(loss, range(2), x)
    assert here.gradients.shape == (2, 8) and not np.allclose(here.gradients[0], here.gradients[1], rtol=0.01)
    # The 1/255 cut-off jumps; a tenth of a pixel passes over its steps.
    steps = 0.1 / joint.pixels(x, model.gaussians)
    measured = []
    for e, h in zip(np.eye(8), steps, strict=True):
        after, before = (joint.evaluate(loss, range(2), x + sign * h * e).losses.mean() for sign in (1, -1))
        measured.append((after - before) / (2 * h))
    scaled = here.gradient * steps
    np.testing.assert_allclose(scaled, np.array(measured) * steps, atol=0.05 * np.abs(scaled).max())
    assert (np.abs(scaled) > 1e-6).all()


def test_both_back_ends_have_the_same_derivatives() -> None:
    scene, model = sequence()
    joint, x = Joint(scene, everything(), Counter(None)), np.array([0.03, 0.3, -0.2, 0.1, 0.4, -0.3, 0.5, 0.2])
    fast, slow = (joint.evaluate(objective(scene, model, 2, reference=r), range(1), x) for r in (False, True))
    assert fast.losses[0] == pytest.approx(slow.losses[0], rel=1e-5)
    np.testing.assert_allclose(fast.gradient, slow.gradient, atol=1e-3 * np.abs(slow.gradient).max())
    np.testing.assert_allclose(fast.gauss_newton, slow.gauss_newton, atol=1e-3 * np.abs(slow.gauss_newton).max())


def test_the_hessian_is_the_gradients_slope() -> None:
    scene, model = sequence()
    loss = objective(scene, model)
    joint, x = Joint(scene, everything(), Counter(None)), np.zeros(8)
    hessian = joint.hessian(loss, range(2), x, 0.3 / joint.pixels(x, model.gaussians))
    np.testing.assert_array_equal(hessian, hessian.T)
    point = joint.evaluate(loss, range(2), x)
    # Near the truth, with pictures that agree, Gauss–Newton's matrix is close.
    assert np.linalg.norm(hessian - point.gauss_newton) < 0.6 * np.linalg.norm(hessian)
    assert (np.linalg.eigvalsh(positive(hessian, point.gauss_newton)) > 0).all()


# --- recovery ----------------------------------------------------------------------------------------


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
    assert estimate.refinement.undecided == ["baseline direction, a", "baseline direction, b"]
    focal = estimate.refinement.freedoms[-1]
    assert focal.decided and focal.std < 1.0 and focal.prior_std == pytest.approx(5.0)  # per cent
    # The length is not refined: its uncertainty is the scale's.
    assert estimate.calibration_std_log == pytest.approx(0.04)
    assert estimate.std_log is not None and estimate.std_log > 0.04


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


# --- what the covariance says ------------------------------------------------------------------------


def test_the_covariance_is_that_of_repeated_experiments() -> None:
    rng = np.random.default_rng(0)
    root, h = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    hessian, g, prior, weight = h @ h.T + np.eye(3), root @ root.T, np.diag([0.0, 1.0, 1.0]), 0.7
    expected = covariance(hessian, g, prior, weight)
    truth = rng.normal(size=(100_000, 3)) * [0, 1, 1]  # drawn from the prior; the first has none, and its place does not matter
    slope = rng.normal(size=(100_000, 3)) @ root.T  # of the loss at the truth
    # The minimum of the loss, quadratic about the truth, and the prior's term.
    found = np.linalg.solve(hessian + weight * prior, (truth @ hessian - slope).T).T
    np.testing.assert_allclose(np.cov((found - truth).T), expected, rtol=0.05, atol=0.02 * np.abs(expected).max())


def test_noise_of_the_mean_gradient() -> None:
    rng = np.random.default_rng(1)
    alone = [noise(rng.normal(size=(500, 2)) * [1.0, 3.0]) * 500 for _ in range(40)]
    np.testing.assert_allclose(np.mean(alone, axis=0), np.diag([1.0, 9.0]), atol=0.4)
    runs = [noise(np.repeat(rng.normal(size=(250, 2)), 2, axis=0)) * 250 for _ in range(40)]  # neighbours err alike
    np.testing.assert_allclose(np.mean(runs, axis=0), np.eye(2), atol=0.15)
    assert (np.linalg.eigvalsh(noise(rng.normal(size=(5, 8)))) > -1e-12).all()  # fewer frames than unknowns


# --- time --------------------------------------------------------------------------------------------


def test_time_runs_through_the_neighbours() -> None:
    scene, _ = sequence()
    names = [f.name for f in scene.frames]
    for offset, there in ((1.0, 6), (-1.0, 4), (0.0, 5)):
        pose = with_rig(scene, replace(RIG, time_offset=offset)).world_from_rgb_at_thermal(names[5])
        np.testing.assert_allclose(pose.matrix(), scene.world_from_rgb[names[there]].matrix(), atol=1e-12)
    late = with_rig(scene, replace(RIG, time_offset=0.5))
    middle = late.world_from_rgb_at_thermal(names[5])
    angle = 0.1 * 5.5
    true = look_at([2.6 * math.cos(angle), 2.6 * math.sin(angle), 0.9 * math.sin(0.5 * 5.5)], [0, 0, 0])
    np.testing.assert_allclose(middle.matrix(), true.matrix(), atol=0.01)
    last = late.world_from_rgb_at_thermal(names[-1])  # straight on
    step = scene.world_from_rgb[names[-1]].translation - scene.world_from_rgb[names[-2]].translation
    np.testing.assert_allclose(last.translation, scene.world_from_rgb[names[-1]].translation + 0.5 * step, atol=1e-12)
    gap = replace(late, world_from_rgb={k: v for k, v in scene.world_from_rgb.items() if k not in (names[4], names[6])})
    np.testing.assert_array_equal(gap.world_from_rgb_at_thermal(names[5]).matrix(), scene.world_from_rgb[names[5]].matrix())


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


# --- settings and records ----------------------------------------------------------------------------


def test_names_of_what_is_refined() -> None:
    assert (
        ScaleConfig(refine=("focal,rotation",)).refine
        == ("rotation", "focal")
        == ScaleConfig(refine=("focal", "rotation")).refine
    )
    with pytest.raises(RtgsError, match=r"scale.refine names 'zoom'; there are rotation, "):
        ScaleConfig(refine=("focal", "zoom"))


def test_stated_deviations_come_before_the_defaults() -> None:
    half = replace(RIG, calibration_std=CalibrationStd(thermal_focal=0.005))
    assert [round(u.std, 6) for u in everything(half)] == [0.005236] * 3 + [0.02] * 2 + [0.005, 0.288675]


def test_the_record_survives_json() -> None:
    scene, model = sequence()
    estimate = estimate_scale(scene, model, ScaleConfig(solver="global", init=1.0, refine=("focal", "time-offset")))
    back = ScaleEstimate.from_json(json.loads(json.dumps(estimate.to_json())))
    assert back == estimate and back.refinement is not None
    assert [f.name for f in back.refinement.freedoms] == ["thermal focal length", "time offset"]
    assert back.refined_scene(scene).rig == estimate.refined_scene(scene).rig or np.allclose(
        back.refined_scene(scene).rig.rgb_from_thermal.matrix(), estimate.refined_scene(scene).rig.rgb_from_thermal.matrix()
    )
    old = {k: v for k, v in estimate.to_json().items() if k != "refinement"}
    assert ScaleEstimate.from_json(old).refined_scene(scene) is scene


def test_nothing_is_refined_about_a_scale_that_is_none(tmp_path: Path) -> None:
    scene, model = sequence()
    blank = with_rig(scene, RIG)
    flat = assembled(
        list(blank.world_from_rgb.values()), [np.full((RIG.thermal.height, RIG.thermal.width), 20.0, np.float32)] * 16, RIG
    )
    estimate = estimate_scale(flat, model, ScaleConfig(solver="global", refine=("focal",)))
    assert estimate.status == "unobservable" and estimate.refinement is None and "not refined" in estimate.reason
