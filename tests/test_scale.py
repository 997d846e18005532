"""The metric scale: Eq. 1, the objective's slope, the bracket's known answer, and that the estimate finds the truth."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import torch

from rtgs.camera import Camera
from rtgs.config import PAPER_EPSILON, PAPER_LEVEL_WEIGHTS, ScaleConfig
from rtgs.errors import RtgsError
from rtgs.gaussians import Gaussians
from rtgs.geometry import SE3, look_at, rotation_from_axis_angle
from rtgs.image import GRAY_WEIGHTS
from rtgs.io.rig import read_rig
from rtgs.models import RgbModel
from rtgs.render import RenderSettings, render
from rtgs.scale import Objective, ScaleEstimate, estimate_scale
from rtgs.scale.bracket import bracket, flow_per_unit
from rtgs.scale.estimate import _scan, adam, bootstrap, curve_minimum
from rtgs.scale.objective import reduced
from rtgs.scene import Capture, Frame, Rig, Scene, SparsePoints
from rtgs.sh import C0

RIG = Rig(
    Camera("PINHOLE", 56, 48, 60.0, 60.0, 28.0, 24.0),
    Camera("PINHOLE", 56, 44, 64.0, 66.0, 27.3, 22.6),
    SE3(rotation_from_axis_angle([0.02, -0.03, 0.04]), np.array([0.16, -0.07, 0.03])),
)
NO_POINTS = SparsePoints(np.zeros((0, 3)), np.zeros((0, 3), np.float32))
QUICK = ScaleConfig(steps=50, learning_rate=0.02, scan_samples=32)


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


def assembled(poses: list[SE3], thermal: list[np.ndarray], rig: Rig = RIG) -> Scene:
    """A scene record in memory; the RGB images are not looked at by the scale."""
    blank = np.zeros((rig.rgb.height, rig.rgb.width, 3), np.float32)
    frames = tuple(Frame(f"{i:03d}", blank, image) for i, image in enumerate(thermal))
    capture = Capture(
        root=Path(),
        raw_rig=rig,
        rig=rig,
        frames=frames,
        rgb_mask=np.ones((rig.rgb.height, rig.rgb.width), bool),
        thermal_mask=np.ones((rig.thermal.height, rig.thermal.width), bool),
        thermal_unit="relative",
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
    return assembled(poses, images), model


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
    camera = reduced(RIG.thermal, 3)
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
    scan = _scan(thetas, shape + level, ["a", "b", "c", "d"])
    # Frames differ in level alone, which says nothing about s.
    np.testing.assert_allclose(scan.std_error, 0.0, atol=1e-12)
    np.testing.assert_allclose(scan.loss, shape + 2.0)
    np.testing.assert_allclose(scan.sfm_per_metre, np.exp(thetas))
    curves = shape + np.array([[0.0, 0, 1], [0, 0, -1], [0, 0, 1], [0, 0, -1]])
    np.testing.assert_allclose(_scan(thetas, curves, list("abcd")).std_error, [0, 0, np.sqrt(4 / 3) / 2])
