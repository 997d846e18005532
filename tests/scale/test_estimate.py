"""The metric scale: Eq. 1, the objective's slope, the bracket's known answer, and that the estimate finds the truth."""

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
from scipy.ndimage import gaussian_filter

from rtgs.base.errors import RtgsError
from rtgs.config import PAPER_EPSILON, PAPER_LEVEL_WEIGHTS, ScaleConfig
from rtgs.images.filters import GRAY_WEIGHTS, blurred
from rtgs.images.patterns import sensor_pattern
from rtgs.io.rig import read_rig
from rtgs.losses.ngf import NgfPyramid
from rtgs.maths.geometry import SE3, is_rotation, look_at, rotation_from_axis_angle
from rtgs.maths.sh import C0
from rtgs.models import RgbModel
from rtgs.records.camera import Camera
from rtgs.records.capture import Capture, Frame, SparsePoints
from rtgs.records.gaussians import Gaussians
from rtgs.records.radiometry import RelativeCounts
from rtgs.records.rig import CalibrationStd, Rig
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings, render
from rtgs.scale import Comparison, Objective, ScaleEstimate, estimate_scale
from rtgs.scale.adam import adam
from rtgs.scale.bracket import bracket, flow_per_unit, information
from rtgs.scale.calibration import calibration_std_log, freedoms
from rtgs.scale.descend import descend
from rtgs.scale.interval import LocalCurves, bootstrap, curve_minima, curve_minimum, hermite, interval, widened
from rtgs.scale.noise import mean_gradients, model_error
from rtgs.scale.objective import Evaluation
from rtgs.scale.records import Counter, History, Scan
from rtgs.scale.search import Pictures, Search, halvings, scan_thetas

RIG = Rig(
    Camera("PINHOLE", 56, 48, 60.0, 60.0, 28.0, 24.0),
    Camera("PINHOLE", 56, 44, 64.0, 66.0, 27.3, 22.6),
    SE3(rotation_from_axis_angle([0.02, -0.03, 0.04]), np.array([0.16, -0.07, 0.03])),
)
NO_POINTS = SparsePoints(np.zeros((0, 3)), np.zeros((0, 3), np.float32))
GLOBAL = ScaleConfig(solver="global")
QUICK = ScaleConfig(solver="adam", steps=50, learning_rate=0.02, scan_samples=32)


def bumpy_ball(n: int = 500) -> Gaussians:
    """A textured shell about the origin, metres."""
    g = torch.Generator().manual_seed(0)
    directions = torch.nn.functional.normalize(torch.randn(n, 3, generator=g), dim=1)
    return Gaussians(
        directions * (0.7 + 0.3 * torch.rand(n, 1, generator=g)),
        torch.randn(n, 4, generator=g),
        math.log(0.09) + 0.3 * torch.randn(n, 3, generator=g),
        torch.full((n,), 2.0),
        ((torch.rand(n, 1, 3, generator=g) - 0.5) / C0),
    )


def assembled(poses: list[SE3], thermal: list[np.ndarray], rig: Rig = RIG, rgb: list[np.ndarray] | None = None) -> Scene:
    """A scene record in memory."""
    blank = [np.zeros((rig.rgb.height, rig.rgb.width, 3), np.float32)] * len(thermal)
    pairs = zip(rgb or blank, thermal, strict=True)
    frames = tuple(Frame(f"{i:03d}", photo, image) for i, (photo, image) in enumerate(pairs))
    capture = Capture(
        root=Path(),
        raw_rig=rig,
        rig=rig,
        frames=frames,
        rgb_mask=np.ones((rig.rgb.height, rig.rgb.width), bool),
        thermal_mask=np.ones((rig.thermal.height, rig.thermal.width), bool),
        radiometry=RelativeCounts(),
        poses=None,
    )
    return Scene(capture, {f.name: p for f, p in zip(frames, poses, strict=True)}, NO_POINTS, {})


@lru_cache(maxsize=8)
def synthetic(sfm_per_metre: float = 1.0, n_frames: int = 8) -> tuple[Scene, RgbModel]:
    """Thermal images of other colours, darker where RGB is brighter, drawn from the true thermal poses; frame 0 is held out."""
    ball = bumpy_ball()
    settings = RenderSettings(near_plane=0.05 * sfm_per_metre)
    model = RgbModel(ball.scaled(sfm_per_metre), torch.tensor([0.1, 0.3, 0.2]), settings)
    gray = (0.5 + C0 * ball.sh[:, 0] @ torch.tensor(GRAY_WEIGHTS)).clamp(0, 1)
    hot = replace(model.gaussians, sh=(((1 - gray) ** 2 - 0.5) / C0)[:, None, None])
    poses = []
    for k in range(n_frames):
        angle = 0.8 * k
        pose = look_at([2.6 * math.cos(angle), 2.6 * math.sin(angle), 0.9 * math.sin(2.1 * k)], [0, 0, 0])
        poses.append(pose.with_baseline_scaled(sfm_per_metre))
    blank = np.zeros((RIG.thermal.height, RIG.thermal.width), np.float32)
    scene = assembled(poses, [blank] * n_frames)
    images = []
    for frame in scene.frames:
        pose = scene.thermal_from_world(frame.name, sfm_per_metre)
        view = render(hot, RIG.thermal, pose, settings=settings).over(torch.tensor([0.9]))
        images.append((20.0 + 15.0 * view[..., 0]).numpy())
    return assembled(poses, images, rgb=photographs(scene, model)), model


def photographs(scene: Scene, model: RgbModel, noise: float = 0.02) -> list[np.ndarray]:
    """What the RGB camera sees, and what a model does not explain."""
    rng, images = np.random.default_rng(1), []
    for frame in scene.frames:
        view = render(model.gaussians, scene.rig.rgb, scene.rgb_from_world(frame.name), settings=model.settings)
        image = view.over(model.background).numpy()
        images.append((image + noise * rng.normal(size=image.shape)).astype(np.float32))
    return images


def objective(scene: Scene, model: RgbModel, epsilon: float, *, reference: bool) -> Objective:
    gaussians = model.gaussians.to(torch.float64) if reference else model.gaussians
    settings = replace(model.settings, backend="reference") if reference else model.settings
    return Objective(
        scene,
        gaussians,
        model.background,
        settings,
        scene.train_frames[:2],
        level_weights=PAPER_LEVEL_WEIGHTS,
        epsilon=epsilon,
    )


# --- Eq. 1 -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("s", [0.0, 0.37, 1.0, 250.0])
def test_only_the_baseline_is_scaled(s: float) -> None:
    scene, _ = synthetic()
    for name, world_from_rgb in scene.world_from_rgb.items():
        pose = scene.world_from_thermal(name, s)
        # The centre of the thermal camera: the RGB camera's, plus s times the baseline seen in the world.
        expected = world_from_rgb.translation + s * world_from_rgb.rotation @ RIG.rgb_from_thermal.translation
        np.testing.assert_allclose(pose.translation, expected, atol=1e-12)
        np.testing.assert_allclose(pose.rotation, world_from_rgb.rotation @ RIG.rgb_from_thermal.rotation, atol=1e-12)
        assert np.linalg.norm(pose.translation - world_from_rgb.translation) == pytest.approx(s * RIG.baseline_m, abs=1e-12)
        np.testing.assert_allclose((scene.thermal_from_world(name, s) @ pose).matrix(), np.eye(4), atol=1e-12)


def test_a_point_seen_by_both_cameras_is_one_point() -> None:
    # A point 2 m before the thermal camera, taken through the rig in metres and through the scene in SfM units.
    s, in_thermal_m = 40.0, np.array([0.3, -0.2, 2.0])
    pose = SE3(rotation_from_axis_angle([0.3, 1.0, -0.4]), np.array([5.0, -3.0, 2.0]))
    scene = assembled([pose], [np.zeros((44, 56), np.float32)])
    through_rgb = pose.apply(s * RIG.rgb_from_thermal.apply(in_thermal_m))
    np.testing.assert_allclose(scene.world_from_thermal("000", s).apply(s * in_thermal_m), through_rgb, atol=1e-10)


def test_either_direction_of_the_rig_file_is_the_same_rig(tmp_path: Path) -> None:
    pinhole = {"model": "PINHOLE", "width": 56, "height": 48, "fl_x": 60.0, "fl_y": 60.0, "cx": 28.0, "cy": 24.0}
    rigs = []
    for key, transform in {
        "rgb_from_thermal": RIG.rgb_from_thermal,
        "thermal_from_rgb": RIG.rgb_from_thermal.inverse(),
    }.items():
        path = tmp_path / f"{key}.json"
        path.write_text(json.dumps({"rgb": pinhole, "thermal": pinhole, key: transform.matrix().tolist()}))
        rigs.append(read_rig(path).rig)
    for rig in rigs:
        np.testing.assert_allclose(rig.rgb_from_thermal.matrix(), RIG.rgb_from_thermal.matrix(), atol=1e-12)
    assert np.abs(RIG.rgb_from_thermal.matrix() - RIG.rgb_from_thermal.inverse().matrix()).max() > 0.1  # the test can tell


# --- the objective ---------------------------------------------------------------------------------


@pytest.mark.parametrize("epsilon", [PAPER_EPSILON, 0.05])
@pytest.mark.parametrize("theta", [-0.3, 0.02])
def test_slope_equals_central_differences_in_float64(theta: float, epsilon: float) -> None:
    # Each splat's 1/255 edge crosses pixels at a few thousand values of θ per unit, and each crossing is a jump the derivative does
    # not see: a step of 1e-7 meets none, and float64 still gives the difference eight digits less seven.
    scene, model = synthetic()
    loss, h = objective(scene, model, epsilon, reference=True), 1e-7
    value, slope = loss.loss_and_slope(1, theta)
    assert value == pytest.approx(loss.loss(1, theta), abs=1e-12)
    expected = (loss.loss(1, theta + h) - loss.loss(1, theta - h)) / (2 * h)
    assert abs(expected) > 0.01
    assert slope == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("theta", [-0.3, 0.02])
def test_slope_of_the_cpu_back_end(theta: float) -> None:
    scene, model = synthetic()
    fast, slow = (objective(scene, model, 0.05, reference=r) for r in (False, True))
    for frame in (0, 1):
        value, slope = fast.loss_and_slope(frame, theta)
        expected_value, expected_slope = slow.loss_and_slope(frame, theta)
        # The image agrees to 1e-5 and ε is 0.05, so the loss to 1e-4 and better; the slope is a difference of like terms.
        assert value == pytest.approx(expected_value, abs=1e-4)
        assert slope == pytest.approx(expected_slope, rel=5e-3, abs=1e-3)
        # And by the loss itself: its float32 noise is 1e-6 and its jumps even out over a step of 5e-3.
        secant = (fast.loss(frame, theta + 5e-3) - fast.loss(frame, theta - 5e-3)) / 1e-2
        assert slope == pytest.approx(secant, rel=0.25, abs=0.05)


@pytest.mark.parametrize("reference", [False, True])
@pytest.mark.parametrize("theta", [-0.3, 0.02])
def test_forward_mode_equals_reverse_mode(theta: float, reference: bool) -> None:
    scene, model = synthetic()
    loss = objective(scene, model, 0.05, reference=reference)
    for frame in (0, 1):
        (value, slope), expected = loss.loss_and_slope(frame, theta), loss.loss_and_slope_in_reverse(frame, theta)
        assert value == pytest.approx(expected[0], abs=1e-12 if reference else 1e-5)
        # float32: a slope is a sum of 2000 terms that largely cancel.
        assert slope == pytest.approx(expected[1], rel=1e-9 if reference else 2e-3, abs=1e-9 if reference else 2e-4)


def test_curvature_is_that_of_the_residuals_in_both_back_ends() -> None:
    scene, model = synthetic()
    fast, slow = (objective(scene, model, 0.05, reference=r) for r in (False, True))
    for theta in (-0.3, 0.02):
        found, expected = fast.evaluate(0, theta), slow.evaluate(0, theta)
        assert expected.curvature > 1.0
        assert found.curvature == pytest.approx(expected.curvature, rel=5e-3)
        assert (found.loss, found.slope) == fast.loss_and_slope(0, theta)


def test_a_reduced_objective_compares_pictures_drawn_small() -> None:
    scene, model = synthetic()
    small = Objective(
        scene, model.gaussians, model.background, model.settings, scene.train_frames[:2],
        level_weights=(1.0,), epsilon=0.05, reduction=3,
    )  # fmt: skip
    camera = RIG.thermal.reduced(3)
    assert (camera.width, camera.height) == (18, 14) and small.gray(0, torch.tensor(0.0)).shape == (14, 18)
    # 56 = 3 · 18 + 2: the focal length is a third all the same, and a ray keeps its block.
    assert camera.fl_x == RIG.thermal.fl_x / 3 and camera.cy == RIG.thermal.cy / 3
    assert small.loss(0, 0.0) < small.loss(0, 0.5)


def test_the_loss_falls_towards_the_truth_from_both_sides() -> None:
    scene, model = synthetic()
    loss = objective(scene, model, PAPER_EPSILON, reference=False)
    values = [np.mean([loss.loss(i, t) for i in (0, 1)]) for t in (-0.4, -0.1, 0.0, 0.1, 0.4)]
    assert values[0] > values[1] > values[2] < values[3] < values[4]


def test_a_slope_without_anything_in_view_is_zero() -> None:
    scene, model = synthetic()
    nothing = replace(model, gaussians=replace(model.gaussians, opacity_logits=torch.full((500,), -50.0)))
    assert objective(scene, nothing, PAPER_EPSILON, reference=False).loss_and_slope(0, 0.1) == (1.0, 0.0)


# --- the bracket -----------------------------------------------------------------------------------


def wall(depth: float, background: float = 0.0) -> tuple[Scene, RgbModel]:
    """An opaque wall across the view of frame 001, seen square on, and a rig whose baseline is 0.2 m to the side."""
    rig = replace(RIG, rgb_from_thermal=SE3(np.eye(3), np.array([0.2, 0.0, 0.0])))
    scene = assembled([SE3.identity()] * 2, [np.zeros((44, 56), np.float32)] * 2, rig)
    xy = torch.cartesian_prod(torch.linspace(-1, 1, 15), torch.linspace(-1, 1, 15)) * depth
    n = len(xy)
    gaussians = Gaussians(
        torch.cat([xy, torch.full((n, 1), depth)], dim=1),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1),
        torch.tensor([0.1 * depth, 0.1 * depth, 1e-4 * depth]).log().repeat(n, 1),
        torch.full((n,), 4.0),
        torch.zeros(n, 1, 3),
    )
    return scene, RgbModel(gaussians, torch.full((3,), background), RenderSettings(near_plane=1e-3 * depth))


@pytest.mark.parametrize("depth", [0.004, 5.0, 3000.0])
def test_flow_of_a_wall_is_focal_length_times_baseline_over_depth(depth: float) -> None:
    scene, model = wall(depth)
    flow = flow_per_unit(scene, model.gaussians, model.settings)
    assert len(flow) == 44 * 56
    expected = 64.0 * 0.2 / depth
    np.testing.assert_allclose(flow, expected, rtol=1e-5)
    lo, hi = bracket(flow, 56)
    assert lo == pytest.approx(0.5 / expected, rel=1e-5)  # half a pixel
    assert hi == pytest.approx(28.0 / expected, rel=1e-5)  # half the image


def test_flow_is_what_pixels_do() -> None:
    # A baseline that also goes forward and a turned camera, against the motion of the projected point itself.
    scene, model = wall(5.0)
    rig = replace(scene.rig, rgb_from_thermal=RIG.rgb_from_thermal)
    scene = assembled([SE3.identity()] * 2, [np.zeros((44, 56), np.float32)] * 2, rig)
    flow = flow_per_unit(scene, model.gaussians, model.settings).reshape(44, 56)
    camera, h = rig.thermal, 1e-5
    for i, j in ((3, 5), (50, 40)):
        ray = np.array([(i + 0.5 - camera.cx) / camera.fl_x, (j + 0.5 - camera.cy) / camera.fl_y, 1.0])
        in_rgb = rig.rgb_from_thermal.rotation @ ray
        point = in_rgb * 5.0 / in_rgb[2]  # on the wall
        x, y, z = scene.thermal_from_world("001", h).apply(point)
        moved = np.array([camera.fl_x * x / z + camera.cx, camera.fl_y * y / z + camera.cy]) - (i + 0.5, j + 0.5)
        # Mean depth over a Gaussian as deep as it is thin: the wall is tilted by a twentieth against this camera.
        assert flow[j, i] == pytest.approx(np.linalg.norm(moved) / h, rel=0.01)


# --- the estimate ----------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
def test_the_truth_is_found_in_any_sfm_unit_without_a_start(unit: float) -> None:
    scene, model = synthetic(unit)
    estimate = estimate_scale(scene, model, QUICK)
    assert estimate.sfm_per_metre == pytest.approx(unit, rel=0.01)
    assert estimate.metres_per_sfm == pytest.approx(1 / unit, rel=0.01)
    assert estimate.status == "ok" and estimate.reason == ""
    assert estimate.bracket[0] < unit < estimate.bracket[1]
    assert estimate.frames == [f.name for f in scene.train_frames] and "000" not in estimate.frames
    assert estimate.baseline_m == pytest.approx(RIG.baseline_m)
    assert estimate.scan is not None and len(estimate.scan.loss) == QUICK.scan_samples
    assert set(estimate.scan.per_frame) == set(estimate.frames)
    assert estimate.std_log is not None and estimate.ci95 is not None
    assert 0 < estimate.std_log < 0.02 and estimate.ci95[0] <= estimate.sfm_per_metre * 1.005
    assert len(estimate.history.step) == QUICK.steps and estimate.history.sfm_per_metre[0] == pytest.approx(estimate.init)


@pytest.mark.parametrize("factor", [1 / 1.8, 1.8])
def test_the_truth_is_found_from_a_start_far_off(factor: float) -> None:
    scene, model = synthetic()
    estimate = estimate_scale(scene, model, replace(QUICK, init=factor, steps=80))
    assert estimate.sfm_per_metre == pytest.approx(1.0, rel=0.01)
    assert estimate.scan is None and estimate.init == factor
    assert estimate.history.sfm_per_metre[0] == pytest.approx(factor)


@pytest.mark.parametrize(
    "change", [{"batch": 2, "learning_rate": 5e-3}, {"level_weights": (1.0,)}, {"epsilon": 0.05}, {"max_frames": 4}]
)
def test_the_truth_is_found_with_other_settings(change: dict) -> None:
    scene, model = synthetic()
    estimate = estimate_scale(scene, model, replace(QUICK, init=1.1, **change))
    assert estimate.sfm_per_metre == pytest.approx(1.0, rel=0.01)
    assert len(estimate.frames) == change.get("max_frames", 7)


def test_mini_batches_are_drawn_anew_and_by_the_seed() -> None:
    scene, model = synthetic()
    loss = objective(scene, model, 0.05, reference=False)
    runs = [adam(loss, 0.1, ScaleConfig(steps=8, batch=1, seed=seed))[1].loss for seed in (0, 0, 1)]
    assert runs[0] == runs[1] != runs[2]


def test_the_same_call_gives_the_same_estimate_and_held_out_images_do_not_matter() -> None:
    scene, model = synthetic()
    config = replace(QUICK, init=1.3, steps=10)
    held_out = {f.name for f in scene.held_out_frames}
    assert held_out == {"000"}
    spoiled = assembled(
        list(scene.world_from_rgb.values()),
        [f.thermal[::-1].copy() * 100 if f.name in held_out else f.thermal for f in scene.frames],
    )
    changed = assembled(
        list(scene.world_from_rgb.values()),
        [f.thermal[::-1].copy() if f.name == "001" else f.thermal for f in scene.frames],
    )
    first, again, without, other = (
        json.dumps(estimate_scale(s, model, config).to_json()) for s in (scene, scene, spoiled, changed)
    )
    assert first == again == without
    assert first != other  # a training image does matter


def test_json_round_trip() -> None:
    scene, model = synthetic()
    for config in (replace(QUICK, steps=2, scan_samples=4), replace(QUICK, steps=2, init=1.0)):
        estimate = estimate_scale(scene, model, config)
        text = json.dumps(estimate.to_json(), allow_nan=False)
        data = json.loads(text)
        assert {"sfm_per_metre", "metres_per_sfm", "std_log", "ci95", "status"} <= set(data)
        assert ScaleEstimate.from_json(data) == estimate


def test_progress_counts_every_render() -> None:
    scene, model = synthetic()
    seen: list[tuple[int, int]] = []
    config = replace(QUICK, steps=2, scan_samples=3, batch=2)
    estimate_scale(scene, model, config, progress=lambda done, total, _: seen.append((done, total)))
    assert [done for done, _ in seen] == list(range(1, len(seen) + 1))
    assert seen[-1][0] == seen[-1][1]


def test_one_training_frame_says_nothing_about_its_error() -> None:
    scene, model = synthetic(1.0, 2)
    estimate = estimate_scale(scene, model, replace(QUICK, init=1.05, steps=3))
    assert estimate.frames == ["001"]
    assert estimate.std_log is None and estimate.ci95 is None
    assert ScaleEstimate.from_json(json.loads(json.dumps(estimate.to_json()))) == estimate


def test_a_scale_that_is_too_small_to_see_is_not_sold_as_found() -> None:
    # The thermal images of a rig without a baseline: the best scale is zero, below everything the images can tell.
    scene, model = synthetic()
    without = replace(scene.rig, rgb_from_thermal=SE3(RIG.rgb_from_thermal.rotation, np.zeros(3)))
    images = [
        render(
            replace(model.gaussians, sh=-model.gaussians.sh.mean(2, keepdim=True)),
            RIG.thermal,
            assembled([scene.world_from_rgb[f.name]], [f.thermal], without).thermal_from_world("000", 1.0),
        )
        .color[..., 0]
        .numpy()
        for f in scene.frames
    ]
    blind = assembled(list(scene.world_from_rgb.values()), images)
    for config in (replace(QUICK, steps=2), replace(QUICK, init=0.02, steps=2)):
        estimate = estimate_scale(blind, model, config)
        assert estimate.status == "unobservable" and "below" in estimate.reason


@pytest.mark.parametrize("init", [0.0, -1.0, float("nan"), float("inf")])
def test_a_start_that_is_no_scale_is_refused(init: float) -> None:
    scene, model = synthetic()
    with pytest.raises(RtgsError, match="init"):
        estimate_scale(scene, model, ScaleConfig(init=init))


@pytest.mark.parametrize("batch", [0, -3])
def test_a_batch_of_no_frames_is_refused(batch: int) -> None:
    scene, model = synthetic()
    with pytest.raises(RtgsError, match="batch"):
        estimate_scale(scene, model, ScaleConfig(batch=batch))


def test_a_rig_without_a_baseline_is_refused() -> None:
    with pytest.raises(RtgsError, match="baseline is zero"):
        bracket(np.zeros(5), 64)


def test_nothing_to_compare_is_said() -> None:
    scene, model = synthetic()
    only_held_out = assembled([scene.world_from_rgb["000"]], [scene.frames[0].thermal])
    with pytest.raises(RtgsError, match="no training frame"):
        estimate_scale(only_held_out, model)
    empty = replace(model, gaussians=replace(model.gaussians, opacity_logits=torch.full((500,), -50.0)))
    with pytest.raises(RtgsError, match="covers no pixel"):
        estimate_scale(scene, empty)


# --- the interval ----------------------------------------------------------------------------------


def test_minimum_of_a_parabola_is_found_between_uneven_samples() -> None:
    thetas = np.array([-0.4, -0.1, 0.0, 0.05, 0.3])
    assert curve_minimum(thetas, 3 * (thetas - 0.02) ** 2 + 5) == pytest.approx(0.02, abs=1e-9)
    assert curve_minimum(thetas, thetas) == -0.4 and curve_minimum(thetas, -thetas) == 0.3
    assert curve_minimum(thetas, np.array([1.0, 0.0, 0.0, 0.0, 1.0])) == pytest.approx(-0.1, abs=0.3)  # flat: no number is wrong


def test_bootstrap_of_parabolas_is_the_error_of_their_mean() -> None:
    rng = np.random.default_rng(0)
    thetas, minima = np.linspace(-1, 1, 41) + 0.5, rng.normal(0.5, 0.1, 25)
    curves = 2 * (thetas[None] - minima[:, None]) ** 2 + rng.normal(size=(25, 1))
    std, (lo, hi) = bootstrap(thetas, curves, seed=0)
    # The minimum of a mean of equal parabolas is the mean of their minima. 1000 resamples know a deviation to 2–3 %.
    expected = minima.std() / 5
    assert std == pytest.approx(expected, rel=0.1)
    assert math.log(lo) == pytest.approx(minima.mean() - 1.96 * expected, abs=0.3 * expected)
    assert math.log(hi) == pytest.approx(minima.mean() + 1.96 * expected, abs=0.3 * expected)
    assert bootstrap(thetas, curves, seed=0) == (std, (lo, hi))
    same = bootstrap(thetas, np.repeat(curves[:1], 6, axis=0), seed=0)
    assert same[0] == pytest.approx(0.0, abs=1e-12) and same[1][0] == pytest.approx(same[1][1])


def test_standard_error_is_paired() -> None:
    thetas = np.array([0.0, 0.1, 0.2])
    shape, level = np.array([0.5, 0.1, 0.3]), np.array([[0.0], [3.0], [-2.0], [7.0]])
    scan = Scan.of(thetas, shape + level, ["a", "b", "c", "d"])
    # Frames differ in level alone, which says nothing about s.
    np.testing.assert_allclose(scan.std_error, 0.0, atol=1e-12)
    np.testing.assert_allclose(scan.loss, shape + 2.0)
    np.testing.assert_allclose(scan.sfm_per_metre, np.exp(thetas))
    curves = shape + np.array([[0.0, 0, 1], [0, 0, -1], [0, 0, 1], [0, 0, -1]])
    np.testing.assert_allclose(Scan.of(thetas, curves, list("abcd")).std_error, [0, 0, np.sqrt(4 / 3) / 2])


# --- the global search -----------------------------------------------------------------------------


def drawn(model: RgbModel, poses: list[SE3], rig: Rig, sfm_per_metre: float, noise: float = 0.0) -> Scene:
    """Photographs, and thermal images that the model's own inverted gray gives at the true thermal poses, in counts."""
    blank = np.zeros((rig.thermal.height, rig.thermal.width), np.float32)
    scene, rng, images = assembled(poses, [blank] * len(poses), rig), np.random.default_rng(0), []
    settings = replace(model.settings, channel_weights=GRAY_WEIGHTS)
    for frame in scene.frames:
        pose = scene.thermal_from_world(frame.name, sfm_per_metre)
        view = render(model.gaussians, rig.thermal, pose, settings=settings)
        gray = view.over(model.background @ torch.tensor(GRAY_WEIGHTS))[..., 0].numpy()
        image = 100.0 - 40.0 * gray**2
        images.append((image + noise * rng.normal(size=image.shape)).astype(np.float32))
    return assembled(poses, images, rig, photographs(scene, model))


def cloud(seed: int) -> Gaussians:
    """A textured shell, a cluttered ball, or a floor with posts; about the origin, metres."""
    g = torch.Generator().manual_seed(seed)
    ball = bumpy_ball()
    if seed == 1:
        return replace(ball, means=1.1 * torch.randn(500, 3, generator=g).clamp(-1.2, 1.2))
    if seed == 2:
        flat = torch.rand(500, 3, generator=g) * torch.tensor([2.4, 2.4, 0.1]) - torch.tensor([1.2, 1.2, 0.6])
        flat[400:, 2] = torch.rand(100, generator=g) - 0.5
        return replace(ball, means=flat)
    return ball


FORWARDS = replace(RIG, rgb_from_thermal=SE3(RIG.rgb_from_thermal.rotation, np.array([0.05, 0.02, 0.2])))


def spiral(seed: int, rig: Rig, sfm_per_metre: float, unit: float = 1.0) -> tuple[Scene, RgbModel]:
    """A cloud seen from thirteen places about it, in whatever unit."""
    model = RgbModel(cloud(seed).scaled(sfm_per_metre), torch.full((3,), 0.4), RenderSettings(near_plane=0.05 * unit))
    poses = []
    for k in range(13):
        angle = 0.55 * k
        eye = np.array([2.8 * math.cos(angle), 2.8 * math.sin(angle), 0.5 + 0.4 * math.sin(2.1 * k)])
        poses.append(look_at(eye, [0, 0, 0]).with_baseline_scaled(sfm_per_metre))
    return drawn(model, poses, rig, sfm_per_metre, noise=0.3), model


def test_a_loss_per_edge_does_not_prefer_to_stand_nearer() -> None:
    """Where the baseline points forwards, Eq. 6 with an ε of the size of edges falls with their number and sharpness."""
    scene, model = spiral(1, FORWARDS, 1.3)
    per_edge = estimate_scale(scene, model, GLOBAL).sfm_per_metre
    eq_6 = estimate_scale(scene, model, GLOBAL, comparison=Comparison(per_edge=False)).sfm_per_metre
    assert abs(per_edge / 1.3 - 1) < 0.01
    assert abs(eq_6 / 1.3 - 1) > 0.015


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_global_search_finds_the_truth_in_any_unit(seed: int) -> None:
    truth, found = 1.3, []
    # The second rig's baseline points forwards, the third camera's field of view is another.
    rig = (RIG, FORWARDS, replace(RIG, thermal=replace(RIG.thermal, fl_x=48.0, fl_y=47.0)))[seed]
    for unit in (1e-4, 1.0, 1e4):
        scene, model = spiral(seed, rig, unit * truth, unit)
        estimate = estimate_scale(scene, model, GLOBAL)
        assert estimate.solver == "global" and estimate.status == "ok" and estimate.reason == ""
        assert estimate.sfm_per_metre == pytest.approx(unit * truth, rel=0.01)
        assert estimate.ci95 is not None and estimate.std_log is not None
        assert estimate.ci95[0] < estimate.sfm_per_metre < estimate.ci95[1] and 0 < estimate.std_log < 0.02
        assert not {"000", "008"} & set(estimate.frames) and estimate.disagreeing == []
        assert estimate.renders < 200 * len(estimate.frames)
        assert ScaleEstimate.from_json(json.loads(json.dumps(estimate.to_json(), allow_nan=False))) == estimate
        found.append(estimate.sfm_per_metre / unit)
    np.testing.assert_allclose(found, found[1], rtol=2e-3)


@pytest.mark.parametrize("share", [0.25, 0.5])
def test_a_coarse_thermal_camera_and_half_of_the_view(share: float) -> None:
    """Thermal pixels four times as large, or a camera that sees beyond the model: silhouettes and a part of the picture remain."""
    camera = Camera("PINHOLE", 224, 192, 240.0, 240.0, 112.0, 96.0)
    thermal = camera.resized(56, 48) if share == 0.25 else replace(camera.resized(112, 96), cx=10.0)
    rig = replace(RIG, rgb=camera, thermal=thermal)
    model = RgbModel(cloud(2), torch.full((3,), 0.4), RenderSettings(near_plane=0.05))
    estimate = estimate_scale(drawn(model, orbit(), rig, 1.0, noise=0.3), model, GLOBAL)
    assert estimate.status == "ok" and estimate.sfm_per_metre == pytest.approx(1.0, rel=0.01)


def test_the_search_ends_in_the_minimum_of_the_loss_itself() -> None:
    scene, model = synthetic()
    estimate = estimate_scale(scene, model, ScaleConfig(solver="global", epsilon=0.05))
    loss = Objective(
        scene, model.gaussians, model.background, model.settings, scene.train_frames,
        level_weights=PAPER_LEVEL_WEIGHTS, epsilon=0.05,
    )  # fmt: skip
    thetas = math.log(estimate.sfm_per_metre) + np.linspace(-0.02, 0.02, 41)
    curve = np.array([np.mean([loss.loss(i, t) for i in range(len(scene.train_frames))]) for t in thetas])
    assert abs(curve_minimum(thetas, curve) - math.log(estimate.sfm_per_metre)) < 2e-3
    assert curve[20] <= curve.min() + 1e-5


def test_progress_of_the_search_ends_at_its_end() -> None:
    scene, model = synthetic()
    seen: list[tuple[int, int]] = []
    estimate = estimate_scale(scene, model, GLOBAL, progress=lambda done, total, _: seen.append((done, total)))
    assert [done for done, _ in seen] == list(range(1, len(seen) + 1))
    assert seen[-1][0] == seen[-1][1] <= estimate.renders


def test_a_start_spares_the_scan() -> None:
    scene, model = synthetic()
    estimate = estimate_scale(scene, model, ScaleConfig(solver="global", init=1.15))
    assert estimate.scan is None and estimate.init == pytest.approx(1.15)
    assert estimate.sfm_per_metre == pytest.approx(1.0, rel=0.01)


def facing_walls(depth: float, stripes: int | None, noise: float, frames: int = 9) -> tuple[Scene, RgbModel]:
    """A textured wall across the view at `depth` metres, seen from places beside each other; 0.2 m to the side, the thermal camera."""
    rig = replace(RIG, rgb_from_thermal=SE3(np.eye(3), np.array([0.2, 0.0, 0.0])))
    g = torch.Generator().manual_seed(0)
    n = 60
    xy = torch.cartesian_prod(torch.linspace(-1.2, 1.2, n), torch.linspace(-1.0, 1.0, n // 2)) * depth
    level = (
        torch.rand(len(xy), generator=g)
        if stripes is None
        else (torch.arange(n) % stripes < stripes // 2).float().repeat_interleave(n // 2)
    )
    gaussians = Gaussians(
        torch.cat([xy, torch.full((len(xy), 1), depth)], dim=1),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(len(xy), 1),
        torch.tensor([0.025 * depth, 0.04 * depth, 1e-4 * depth]).log().repeat(len(xy), 1),
        torch.full((len(xy),), 4.0),
        ((0.2 + 0.6 * level) - 0.5)[:, None, None].repeat(1, 1, 3) / C0,
    )
    model = RgbModel(gaussians, torch.zeros(3), RenderSettings(near_plane=1e-3 * depth))
    poses = [SE3(np.eye(3), np.array([0.02 * depth * (k % 3), 0.02 * depth * (k // 3), 0.0])) for k in range(frames)]
    return drawn(model, poses, rig, 1.0, noise), model


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_far_wall_tells_nothing_and_says_so(noise: float) -> None:
    scene, model = facing_walls(400.0, None, noise)  # the baseline moves the picture by 0.03 px
    estimate = estimate_scale(scene, model, GLOBAL)
    assert estimate.status == "unobservable" and "below" in estimate.reason
    near = estimate_scale(*facing_walls(2.0, None, noise), GLOBAL)
    assert near.status == "ok" and near.sfm_per_metre == pytest.approx(1.0, rel=0.02)


def test_a_picket_fence_is_ambiguous() -> None:
    # 0.2 m at 2 m is 6.4 px; four columns of the wall are 10.4 px, so 16.8 px fit as well: no edge of the wall is in view.
    estimate = estimate_scale(*facing_walls(2.0, 4, 1.0), GLOBAL)
    assert estimate.status == "ambiguous", estimate
    everything = [estimate.sfm_per_metre, *(m.sfm_per_metre for m in estimate.minima)]
    assert min(abs(s - 1.0) for s in everything) < 0.03
    assert any(m.chance > 0.025 for m in estimate.minima) and f"{estimate.minima[0].sfm_per_metre:.4g}" in estimate.reason


def test_a_wrong_pair_is_named() -> None:
    # Two frames of a camera that has moved by 2.6 px between them are swapped; the scale moves the picture by 6.4 px.
    scene, model = facing_walls(2.0, None, 1.0, 15)
    swapped = {"003": "005", "005": "003"}
    images = {f.name: f.thermal for f in scene.frames}
    poses = [scene.world_from_rgb[f.name] for f in scene.frames]
    wrong = assembled(
        poses, [images[swapped.get(f.name, f.name)] for f in scene.frames], scene.rig, [f.rgb for f in scene.frames]
    )
    assert estimate_scale(scene, model, GLOBAL).disagreeing == []
    estimate = estimate_scale(wrong, model, GLOBAL)
    assert set(estimate.disagreeing) == set(swapped)
    assert estimate.sfm_per_metre == pytest.approx(1.0, rel=0.03)


def test_edges_along_the_flow_and_far_ones_inform_less() -> None:
    near, far = facing_walls(2.0, None, 0.0), facing_walls(8.0, None, 0.0)
    worth = [information(s, m.gaussians, m.settings, s.train_frames) for s, m in (near, far)]
    assert worth[0].shape == (7,)
    np.testing.assert_allclose(worth[0] / worth[1], 16.0, rtol=0.3)  # flow squared
    scene, model = near
    along = [np.repeat(np.linspace(0, 1, 44, dtype=np.float32)[:, None], 56, axis=1)] * 2  # level edges, level flow
    level = assembled([SE3.identity()] * 2, along, scene.rig)
    upright = assembled([SE3.identity()] * 2, [np.tile(np.linspace(0, 1, 56, dtype=np.float32), (44, 1))] * 2, scene.rig)
    a, b = (information(s, model.gaussians, model.settings, s.train_frames)[0] for s in (level, upright))
    assert a < 1e-6 * b


def test_scanned_scales_are_a_coarse_pixel_apart() -> None:
    thetas = scan_thetas((0.02, 2.0), 4)
    flow = np.exp(thetas) / 0.04  # pixels: half of one at the lower end
    assert flow[0] == pytest.approx(0.5) and flow[-1] == pytest.approx(50.0)
    assert (np.diff(flow) <= 4 + 1e-9).all() and (flow[1:] / flow[:-1] <= 1.25 + 1e-9).all() and len(flow) < 30


class Parabola:
    """An objective of known minimum: L = 1 + a·(cosh(θ − m) − 1), whose Gauss–Newton curvature is claimed `excess` times too large."""

    def __init__(self, minimum: float, excess: float) -> None:
        self.minimum, self.excess, self.frames = minimum, excess, (0, 1)

    def evaluate(self, index: int, theta: float) -> Evaluation:
        x = theta - self.minimum
        return Evaluation(1 + 2 * (math.cosh(x) - 1), 2 * math.sinh(x), self.excess * 2 * math.cosh(x))


@pytest.mark.parametrize("excess", [0.1, 1.0, 30.0, 1e5])
def test_descent_reaches_the_minimum_whatever_the_claimed_curvature(excess: float) -> None:
    history = History([], [], [], [])
    place = descend(Parabola(0.3, excess), (0, 1), -0.4, pixel=0.5, tolerance=1e-4, counter=Counter(None), history=history)  # type: ignore[arg-type]
    assert place.theta == pytest.approx(0.3, abs=1e-4) and len(history.step) <= 12
    assert place.curvature == pytest.approx(2.0, rel=0.1)


# --- what is an edge --------------------------------------------------------------------------------


def test_mean_gradients_are_those_of_valid_pixels_level_by_level() -> None:
    ramp = torch.arange(40.0).repeat(24, 1) * 0.01
    mask = np.ones((24, 40), bool)
    np.testing.assert_allclose(mean_gradients([ramp, 3 * ramp], mask, 3), [8 * 0.02, 16 * 0.02, 32 * 0.02], rtol=1e-4)
    spoiled, mask[10, 7] = ramp.clone(), False
    spoiled[10, 7] = float("nan")
    np.testing.assert_allclose(mean_gradients([spoiled], mask, 2), [0.08, 0.16], rtol=1e-4)
    assert mean_gradients([torch.zeros(24, 40)], mask, 1) == (1e-6,)


def test_the_models_error_is_what_photographs_show_of_it() -> None:
    scene, model = posts()
    exact = assembled([scene.world_from_rgb["001"]], [scene.frames[1].thermal], RIG, photographs(scene, model, 0.0)[1:2])
    assert model_error(exact, model, exact.frames[0]).abs().max() < 1e-5
    frame = scene.frames[1]
    noisy = model_error(scene, model, frame)
    assert noisy.shape == (48, 56)
    expected = 0.02 * math.sqrt(sum(w * w for w in GRAY_WEIGHTS))  # the noise of `photographs`, made gray
    assert float(noisy.std()) == pytest.approx(expected, rel=0.05)
    coarse = replace(scene, capture=replace(scene.capture, rig=replace(RIG, thermal=replace(RIG.thermal, fl_x=30.0, fl_y=30.0))))
    assert model_error(coarse, model, frame).shape == (24, 28)  # the thermal camera's pixels per degree


def test_an_epsilon_of_the_size_of_edges_rewards_larger_edges() -> None:
    # Forwards is where edges grow. The thermal images are the model's own, so the minimum belongs at s = 1.
    rig = replace(RIG, rgb_from_thermal=SE3(RIG.rgb_from_thermal.rotation, np.array([0.05, 0.02, 0.2])))
    model = RgbModel(cloud(1), torch.full((3,), 0.4), RenderSettings(near_plane=0.05))
    scene, thetas = drawn(model, orbit(), rig, 1.0), np.linspace(-0.1, 0.1, 21)
    pictures = Pictures.of(scene, model, scene.train_frames, PAPER_LEVEL_WEIGHTS, None, Counter(None))
    assert pictures.renders == 6
    off = []
    for epsilon in (pictures.render_epsilon, pictures.epsilon):
        loss = replace(pictures, render_epsilon=epsilon).objective()
        curves = np.array([[loss.loss(i, t) for t in thetas] for i in range(len(loss.frames))])
        off.append(abs(curve_minimum(thetas, curves.mean(axis=0))))
    assert off[0] < 0.01 and off[1] > 0.02


def soft(scene: Scene, sigma: float) -> Scene:
    """The same with thermal images under a Gaussian."""
    frames = tuple(replace(f, thermal=gaussian_filter(f.thermal, sigma, mode="nearest")) for f in scene.capture.frames)
    return replace(scene, capture=replace(scene.capture, frames=frames))


def test_a_picture_is_blurred_as_scipy_does() -> None:
    image = np.random.default_rng(0).normal(size=(2, 30, 41))
    for sigma in (0.7, 2.0):
        expected = [gaussian_filter(plane, sigma, mode="nearest", radius=math.ceil(3 * sigma)) for plane in image]
        np.testing.assert_allclose(blurred(torch.from_numpy(image), sigma), expected, atol=1e-12)


def test_a_soft_objective_is_the_loss_of_the_blurred_render() -> None:
    scene, model = spiral(0, RIG, 1.3)
    pictures = replace(Pictures.of(scene, model, scene.train_frames, PAPER_LEVEL_WEIGHTS, None, Counter(None)), blur_px=1.5)
    sharp, softer, theta = replace(pictures, blur_px=0.0).objective(), pictures.objective(), math.log(1.2)
    gray = sharp.gray(2, torch.tensor(theta, dtype=torch.float64))
    expected = sharp._fused_ngf(2).loss(blurred(gray[None], 1.5)[0].numpy())
    assert softer.loss(2, theta) == pytest.approx(expected, abs=1e-6)
    np.testing.assert_allclose(sharp.loss_over_blur(2, theta, (0.0, 1.5)), [sharp.loss(2, theta), expected], atol=1e-6)
    assert abs(expected - sharp.loss(2, theta)) > 1e-3
    h = 1e-3
    secant = (softer.loss(2, theta + h) - softer.loss(2, theta - h)) / (2 * h)
    assert softer.evaluate(2, theta).slope == pytest.approx(secant, rel=0.1, abs=0.01)
    assert softer.loss_and_slope_in_reverse(2, theta)[1] == pytest.approx(softer.evaluate(2, theta).slope, rel=0.02, abs=2e-3)


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


def test_renders_as_soft_as_the_lens_halve_the_error() -> None:
    errors = np.zeros((3, 2))
    for seed in range(3):
        scene, model = spiral(seed, RIG, 1.3)
        for column in range(2):
            with pytest.MonkeyPatch.context() as patch:
                if column:
                    patch.setattr(Search, "as_soft_as_the_lens", lambda _, found: found)
                found = estimate_scale(soft(scene, 2.0), model, GLOBAL)
            errors[seed, column] = abs(found.sfm_per_metre / 1.3 - 1)
    assert errors[:, 0].mean() < 0.6 * errors[:, 1].mean()


def test_a_comparison_may_count_only_what_the_model_covers() -> None:
    scene, model = spiral(0, RIG, 1.3)
    of = {
        c: Pictures.of(scene, model, scene.train_frames, (1.0,), None, Counter(None), Comparison(covered=c))
        for c in (False, True)
    }
    theta, frame = math.log(1.2), scene.train_frames[2]
    index = scene.train_frames.index(frame)
    whole, covered = (of[c].objective() for c in (False, True))
    assert of[True].masks is not None
    mask = of[True].masks[frame.name]
    assert 0.05 < mask.mean() < 0.95
    target = NgfPyramid.of(
        torch.from_numpy(of[True].thermal[frame.name]).double(),
        torch.from_numpy(mask),
        level_weights=(1.0,),
        epsilon=of[True].epsilon[0],
        render_epsilon=of[True].render_epsilon[0],
        per_edge=True,
    )
    gray = covered.gray(index, torch.tensor(theta, dtype=torch.float64)).double()
    assert covered.loss(index, theta) == pytest.approx(float(target(gray)), abs=1e-5)
    assert abs(covered.loss(index, theta) - whole.loss(index, theta)) > 1e-3


@pytest.mark.parametrize("weights", [(1.0,), (1.0, 1.0, 1.0, 1.0)])
def test_few_and_many_levels_at_a_size_that_is_halved(weights: tuple[float, ...]) -> None:
    rig = Rig(RIG.rgb.resized(168, 144), RIG.thermal.resized(168, 132), RIG.rgb_from_thermal)
    scene, model = spiral(0, rig, 1.3)
    assert halvings(scene) == 1
    found = estimate_scale(scene, model, replace(GLOBAL, level_weights=weights)).sfm_per_metre
    assert abs(found / 1.3 - 1) < 0.01


@pytest.mark.parametrize("across", [(0.75, 2.5), (0.0, 4.0)])
def test_other_derivative_filters_find_the_scale_too(across: tuple[float, float]) -> None:
    scene, model = spiral(0, RIG, 1.3)
    found = estimate_scale(scene, model, GLOBAL, comparison=Comparison(across=across)).sfm_per_metre
    assert abs(found / 1.3 - 1) < 0.01
    assert found != estimate_scale(scene, model, GLOBAL).sfm_per_metre


def stripes(rng: np.random.Generator, shape: tuple[int, int], size: float) -> np.ndarray:
    """Readout noise of rows and columns, and vignetting."""
    y, x = (np.linspace(-1, 1, n) for n in shape)
    return size * (rng.normal(size=(shape[0], 1)) + rng.normal(size=(1, shape[1])) - 3 * (x[None] ** 2 + y[:, None] ** 2))


def test_a_sensors_pattern_is_found_and_the_scene_left_alone() -> None:
    rng, shape = np.random.default_rng(0), (60, 80)
    pattern = stripes(rng, shape, 0.5)
    noise = rng.normal(size=(24, *shape))
    steady = np.zeros(shape)
    steady[20:40, 30:50] = 5.0  # something that stays in the same place
    for scene in (0.0 * steady, steady):
        images = (20 + scene + pattern + noise).astype(np.float32)
        found = sensor_pattern(images, np.ones(shape, bool))
        fine = lambda image: image - gaussian_filter(image, 3.0)  # noqa: E731
        assert np.corrcoef(fine(found).ravel(), fine(pattern).ravel())[0, 1] > 0.95
        if scene is not steady:
            assert np.corrcoef(found.ravel(), pattern.ravel())[0, 1] > 0.95
        assert abs(fine(found) - fine(pattern)).max() < 1.0  # of the box's edge of 5, nothing
    assert (
        abs(sensor_pattern((20 + noise).astype(np.float32), np.ones(shape, bool))).max() < 0.4
    )  # noise alone agrees with nothing
    assert not sensor_pattern(images[:7], np.ones(shape, bool)).any()  # too few frames to tell


def test_masked_pixels_of_a_pattern_are_not_looked_at() -> None:
    rng, shape = np.random.default_rng(0), (40, 50)
    images = (stripes(rng, shape, 0.5) + rng.normal(size=(12, *shape))).astype(np.float32)
    mask = np.ones(shape, bool)
    mask[:, :6] = False
    spoiled = images.copy()
    spoiled[:, ~mask] = 1e6
    np.testing.assert_allclose(sensor_pattern(images, mask), sensor_pattern(spoiled, mask), atol=0.05)
    assert not sensor_pattern(spoiled, mask)[~mask].any()


def test_a_striped_sensor_does_not_move_the_scale() -> None:
    scene, model = posts()
    pattern = stripes(np.random.default_rng(3), (44, 56), 4.0)
    images = [(f.thermal + pattern).astype(np.float32) for f in scene.frames]
    striped = assembled(list(scene.world_from_rgb.values()), images, RIG, [f.rgb for f in scene.frames])
    found = estimate_scale(striped, model, GLOBAL)
    assert found.status == "ok" and found.sfm_per_metre == pytest.approx(1.0, rel=0.01)


# --- the calibration's share ------------------------------------------------------------------------


def orbit(n: int = 13) -> list[SE3]:
    eyes = [(2.8 * math.cos(0.55 * k), 2.8 * math.sin(0.55 * k), 0.5 + 0.4 * math.sin(2.1 * k)) for k in range(n)]
    return [look_at(eye, [0, 0, 0]) for eye in eyes]


@lru_cache(maxsize=1)
def posts() -> tuple[Scene, RgbModel]:
    model = RgbModel(cloud(2), torch.full((3,), 0.4), RenderSettings(near_plane=0.05))
    return drawn(model, orbit(), RIG, 1.0), model


@pytest.mark.parametrize("k", range(6))
def test_a_calibration_error_moves_the_scale_as_predicted(k: int) -> None:
    scene, model = posts()
    size = [0.004, 0.004, 0.004, 0.04, 0.04, 0.01][k]
    change = freedoms(RIG, CalibrationStd())[k][0]
    loss = Objective(
        scene, model.gaussians, model.background, model.settings, scene.train_frames, level_weights=PAPER_LEVEL_WEIGHTS, epsilon=0.05
    )  # fmt: skip
    matrix = sum(loss.curvatures(i, 0.0, [change]) for i in range(len(loss.frames)))
    assert isinstance(matrix, np.ndarray)
    curvature = sum(loss.evaluate(i, 0.0).curvature for i in range(len(loss.frames)))
    assert matrix[0, 0] == pytest.approx(curvature, rel=1e-4)
    predicted = -matrix[0, 1] / matrix[0, 0] * size
    found = []
    for amount in (-size, size):
        off = replace(scene, capture=replace(scene.capture, rig=change(RIG, amount)))
        found.append(estimate_scale(off, model, ScaleConfig(solver="global", init=1.0, epsilon=0.05)).sfm_per_metre)
    moved = math.log(found[1] / found[0]) / 2
    # First order, of a loss that is far from quadratic: 40 %, and a tenth of a pixel where nothing moves.
    assert moved == pytest.approx(predicted, rel=0.4, abs=4e-3)


def test_calibration_errors_move_something() -> None:
    scene, model = posts()
    loss = Objective(
        scene, model.gaussians, model.background, model.settings, scene.train_frames, level_weights=PAPER_LEVEL_WEIGHTS, epsilon=0.05
    )  # fmt: skip
    frames = range(len(loss.frames))
    rotation = calibration_std_log(loss, RIG, 0.0, CalibrationStd(rotation_rad=0.004), frames)
    assert 0.01 < rotation < 0.2
    assert calibration_std_log(loss, RIG, 0.0, CalibrationStd(rotation_rad=0.008), frames) == pytest.approx(
        2 * rotation, rel=1e-6
    )
    assert calibration_std_log(loss, RIG, 0.0, CalibrationStd(baseline_length=0.02), frames) == 0.02
    both = calibration_std_log(loss, RIG, 0.0, CalibrationStd(baseline_length=0.02, rotation_rad=0.004), frames)
    assert both == pytest.approx(math.hypot(0.02, rotation))


def test_the_interval_takes_the_calibration_in() -> None:
    scene, model = posts()
    stated = replace(
        scene, capture=replace(scene.capture, rig=replace(RIG, calibration_std=CalibrationStd(baseline_length=0.03)))
    )
    plain, wide = (estimate_scale(s, model, ScaleConfig(solver="global", init=1.0)) for s in (scene, stated))
    assert plain.calibration_std_log is None and wide.calibration_std_log == 0.03
    assert wide.sfm_per_metre == plain.sfm_per_metre
    assert plain.std_log is not None and wide.std_log == pytest.approx(math.hypot(plain.std_log, 0.03), rel=1e-6)
    assert wide.ci95 is not None and math.log(wide.ci95[1] / wide.ci95[0]) == pytest.approx(2 * 1.96 * 0.03, rel=0.1)


@pytest.mark.parametrize("change, amount", freedoms(RIG, CalibrationStd(1.0, 1.0, 1.0, 1.0)))
def test_freedoms_keep_the_baselines_length(change: Callable[[Rig, float], Rig], amount: float) -> None:
    assert amount == 1.0
    off = change(RIG, 0.02)
    assert off.baseline_m == pytest.approx(RIG.baseline_m, rel=1e-12) and off != RIG
    assert is_rotation(off.rgb_from_thermal.rotation, 1e-12)


# --- the interval of the global search -------------------------------------------------------------


def test_cubics_are_read_exactly_between_their_nodes() -> None:
    thetas, at = np.array([-1.0, -0.2, 0.1, 2.0]), np.linspace(-1, 2, 50)
    cubics = [np.poly1d([0.3, -1, 0.5, 2]), np.poly1d([-1, 0, 0, 1])]
    values, slopes = np.array([p(thetas) for p in cubics]), np.array([p.deriv()(thetas) for p in cubics])
    np.testing.assert_allclose(hermite(thetas, values, slopes, at), [p(at) for p in cubics], atol=1e-12)


def test_minima_of_many_curves_are_those_of_each() -> None:
    rng = np.random.default_rng(0)
    thetas = np.sort(rng.uniform(-1, 1, 9))
    curves = np.concatenate([(thetas - rng.uniform(-1.5, 1.5, (200, 1))) ** 2, rng.normal(size=(200, 9))])
    expected = []
    for curve in curves:
        k = int(np.argmin(curve))
        if k in (0, 8):
            expected.append(thetas[k])
            continue
        a, b, _ = np.polyfit(thetas[k - 1 : k + 2] - thetas[k], curve[k - 1 : k + 2], 2)
        expected.append(thetas[k] - b / (2 * a))
    np.testing.assert_allclose(curve_minima(thetas, curves), expected, atol=1e-9)


@pytest.mark.parametrize("calibration", [0.0, 0.02])
def test_the_interval_covers(calibration: float) -> None:
    """Frames in runs that err alike, few of them, and a calibration that is off: 95 % of the intervals hold the truth."""
    rng, thetas, trials = np.random.default_rng(1), np.linspace(-0.5, 0.5, 101), 300
    held, widths = 0, []
    for trial in range(trials):
        errors = 0.05 * (rng.normal(size=18) + np.repeat(rng.normal(size=6), 3)) / math.sqrt(2)
        minima = errors + calibration * rng.normal()
        curves = rng.uniform(0.5, 2.0, (18, 1)) * (thetas[None] - minima[:, None]) ** 2 + rng.normal(size=(18, 1))
        std, (lo, hi) = interval(thetas, curves, curve_minimum(thetas, curves.mean(axis=0)), calibration, trial)
        held += lo <= 1.0 <= hi
        widths.append(std)
    # 300 trials know a share of 95 % to ± 2.5 % (two standard errors); resampling 18 frames is itself an approximation.
    assert 0.90 <= held / trials <= 0.99
    assert np.median(widths) < 2.2 * math.hypot(0.05 / math.sqrt(18) * math.sqrt(2), calibration)


class Flat:
    """An objective that says nothing."""

    def evaluate(self, index: int, theta: float) -> Evaluation:
        assert abs(theta) < 50, "so far out nothing is to be looked for"
        return Evaluation(1.0, 0.0, 1.0)


def test_a_loss_that_says_nothing_is_not_followed_for_ever() -> None:
    curves = LocalCurves(Flat(), Counter(None))  # type: ignore[arg-type]
    assert not widened(curves, range(6), -20.0, half_width=1e6, pixel=1e6, seed=0)
