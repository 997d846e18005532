"""Training of the RGB model: it learns, keeps its budget, resumes, and never looks at held-out images."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from rtgs.base.errors import RtgsError
from rtgs.config import QUALITIES, DensifyConfig, RgbConfig
from rtgs.maths.adam import Adam
from rtgs.maths.geometry import SE3, look_at
from rtgs.maths.sh import C0
from rtgs.metrics.basic import psnr
from rtgs.models import RgbModel
from rtgs.records.camera import Camera
from rtgs.records.capture import Capture, Frame, SparsePoints
from rtgs.records.gaussians import Gaussians
from rtgs.records.radiometry import RelativeCounts
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings, render
from rtgs.renderer.reference import rotation_from_quats
from rtgs.rgb.densify import ScreenGradients, budget, densify, is_round, target_count
from rtgs.rgb.train import MOST_PACE, NEAR_FRACTION, RATES_STEPS, SETTLE_TO, _Training, fit_rgb, initial_gaussians

CAMERA = Camera("PINHOLE", 40, 40, 44.0, 44.0, 20.0, 20.0)
NO_POINTS = SparsePoints(np.zeros((0, 3)), np.zeros((0, 3), np.float32))
QUICK = RgbConfig(
    steps=120, sh_degree=1, coarse_to_fine=(), densify=DensifyConfig(max_gaussians=300, every=20, start=0.05, stop=0.6)
)


@lru_cache(maxsize=1)
def synthetic() -> Scene:
    """Ten views of a coloured ball before a grey background; 150 of its 400 centres, displaced, are the sparse points."""
    g = torch.Generator().manual_seed(0)
    n = 400
    directions = torch.nn.functional.normalize(torch.randn(n, 3, generator=g), dim=1)
    # Colours vary slowly over the ball, so that 40 pixels can show them.
    colors = 0.5 + 0.4 * torch.sin(3.0 * directions @ torch.randn(3, 3, generator=g))
    truth = Gaussians(
        directions * (0.9 + 0.1 * torch.rand(n, 1, generator=g)),
        torch.randn(n, 4, generator=g),
        math.log(0.1) + 0.2 * torch.randn(n, 3, generator=g),
        torch.full((n,), 3.0),
        ((colors - 0.5) / C0)[:, None],
    )
    poses, frames = {}, []
    for k in range(10):
        pose = look_at([3 * math.cos(0.63 * k), 3 * math.sin(0.63 * k), 0.8 * math.sin(1.7 * k)], [0, 0, 0])
        view = render(truth, CAMERA, pose.inverse(), settings=RenderSettings()).over(torch.tensor([0.3, 0.35, 0.4]))
        poses[f"{k:03d}"] = pose
        frames.append(Frame(f"{k:03d}", view.numpy().clip(0, 1), np.zeros((40, 40), np.float32)))
    points = truth.means[:150] + 0.02 * torch.randn(150, 3, generator=g)
    return assembled(frames, poses, SparsePoints(points.double().numpy(), colors[:150].numpy()))


def assembled(frames: list[Frame], poses: dict[str, SE3], points: SparsePoints, mask: np.ndarray | None = None) -> Scene:
    rig = Rig(CAMERA, CAMERA, SE3(np.eye(3), np.array([0.1, 0.0, 0.0])))
    everywhere = np.ones((40, 40), bool)
    capture = Capture(Path(), rig, rig, tuple(frames), everywhere if mask is None else mask, everywhere, RelativeCounts(), None)
    return Scene(capture, poses, points, {})


def with_images(scene: Scene, change: dict[str, np.ndarray], mask: np.ndarray | None = None) -> Scene:
    frames = [replace(f, rgb=change.get(f.name, f.rgb)) for f in scene.frames]
    return assembled(frames, dict(scene.world_from_rgb), scene.points, mask)


def held_out_psnr(scene: Scene, model: RgbModel) -> float:
    return float(np.mean([psnr(model.render(CAMERA, scene.rgb_from_world(f.name)), f.rgb) for f in scene.held_out_frames]))


def tensors(model: RgbModel) -> dict[str, Tensor]:
    return {**model.gaussians.tensors(), "background": model.background}


def assert_equal(a: RgbModel, b: RgbModel) -> None:
    for name, tensor in tensors(a).items():
        assert torch.equal(tensor, tensors(b)[name]), name


class Interrupted(Exception):
    pass


# --- training --------------------------------------------------------------------------------------


def test_training_improves_views_that_it_never_saw() -> None:
    scene = synthetic()
    start, model = fit_rgb(scene, replace(QUICK, steps=1)), fit_rgb(scene, QUICK)
    assert [f.name for f in scene.held_out_frames] == ["000", "008"]
    before, after = held_out_psnr(scene, start), held_out_psnr(scene, model)
    assert after > before + 5.0 and after > 22.0
    assert model.history["held_out_psnr"][-1] == pytest.approx(after, abs=1e-3)
    assert model.history["step"][-1] == QUICK.steps
    # It starts at the border's median, which is the background already, and at 2e-3 a step it may wander a little.
    np.testing.assert_allclose(model.background, [0.3, 0.35, 0.4], atol=0.05)
    assert model.settings.near_plane == NEAR_FRACTION * scene.extent
    assert all(torch.isfinite(t).all() and not t.requires_grad for t in tensors(model).values())


def test_the_same_call_gives_the_same_model_and_held_out_images_do_not_matter() -> None:
    scene, config = synthetic(), replace(QUICK, steps=50)
    noise = {f.name: 1.0 - f.rgb[::-1].copy() for f in scene.held_out_frames}
    first = fit_rgb(scene, config)
    assert_equal(first, fit_rgb(scene, config))
    without = fit_rgb(with_images(scene, noise), config)
    assert_equal(first, without)
    assert without.history["held_out_psnr"] != first.history["held_out_psnr"]  # scored, for show
    other = fit_rgb(with_images(scene, {"003": 1.0 - scene.frames[3].rgb}), config)
    assert not torch.equal(other.background, first.background)


def test_masked_pixels_do_not_matter() -> None:
    scene, config = synthetic(), replace(QUICK, steps=12, background="black")
    mask = np.ones((40, 40), bool)
    mask[:, 31:] = False
    spoiled = {f.name: np.where(mask[..., None], f.rgb, 1.0 - f.rgb) for f in scene.frames}
    assert_equal(fit_rgb(with_images(scene, {}, mask), config), fit_rgb(with_images(scene, spoiled, mask), config))
    assert not torch.equal(
        fit_rgb(scene, config).gaussians.sh, fit_rgb(with_images(scene, spoiled), config).gaussians.sh
    )  # without the mask they do


@pytest.mark.parametrize("budget", [90, 150, 200])
def test_the_budget_is_never_exceeded(budget: int) -> None:
    seen = []
    config = replace(QUICK, steps=60, densify=replace(QUICK.densify, max_gaussians=budget, every=5))
    scene = synthetic()
    model = fit_rgb(scene, config, progress=lambda step, steps, text: seen.append(int(text.split()[0].replace(",", ""))))
    assert len(seen) == 60 and max(seen) <= budget
    assert max(seen) >= 0.98 * budget  # and it is used, from 150 points on
    assert len(model.gaussians) == seen[-1] and max(model.history["gaussians"]) <= budget


def test_without_points_it_starts_from_random_ones() -> None:
    scene = replace(synthetic(), points=NO_POINTS)
    config = replace(QUICK, random_points=250)
    training = _Training(scene, config)
    means = training.optimizer.parameters["means"].detach().double().numpy()
    assert len(means) == 250
    in_view = np.zeros(250, bool)
    for frame in scene.train_frames:
        x, y, z = scene.rgb_from_world(frame.name).apply(means).T
        u, v = 44 * x / z + 20, 44 * y / z + 20
        in_view |= (z > 0) & (u > 0) & (u < 40) & (v > 0) & (v < 40)
    assert in_view.all()
    assert held_out_psnr(scene, fit_rgb(scene, config)) > held_out_psnr(scene, fit_rgb(scene, replace(config, steps=1))) + 1.0
    assert len(_Training(scene, replace(config, random_points=5000)).gaussians()) == config.densify.max_gaussians


def test_exposure_is_recovered_and_not_used_for_held_out_frames() -> None:
    scene = synthetic()
    gains = {f.name: 0.8 if k % 2 else 1.1 for k, f in enumerate(scene.train_frames)}
    gained = with_images(scene, {f.name: f.rgb * np.float32(gains[f.name]) for f in scene.train_frames})
    config = replace(QUICK, steps=250, exposure=True)
    training = _Training(gained, config)
    while training.step < config.steps:
        training.advance()
    # Gains and offsets share the work, and there are no more of them than training frames: so look at what they do to mid grey.
    fitted = (0.4 * training.frame_optimizer.parameters["gain"] + training.frame_optimizer.parameters["offset"]).detach().mean(1)
    assert training.frame_optimizer.parameters["gain"].shape == (len(scene.train_frames), 3)
    bright = torch.tensor([gains[f.name] > 1 for f in scene.train_frames])
    ratio = (fitted[~bright].mean() / fitted[bright].mean()).item()
    assert fitted[~bright].max() < fitted[bright].min()
    assert ratio == pytest.approx(0.8 / 1.1, abs=0.1)
    model = training.model()
    frame = gained.held_out_frames[0]
    pose = gained.rgb_from_world(frame.name)
    plain = render(training.gaussians(), CAMERA, pose, settings=model.settings).over(model.background).detach().clamp(0, 1)
    np.testing.assert_array_equal(model.render(CAMERA, pose), plain.numpy())
    off = _Training(gained, replace(config, exposure=False))
    for _ in range(5):
        off.advance()
    assert (off.frame_optimizer.parameters["gain"] == 1).all() and (off.frame_optimizer.parameters["offset"] == 0).all()


def test_the_position_rate_falls_a_hundredfold_and_goes_with_the_extent() -> None:
    scene = synthetic()
    training = _Training(scene, replace(QUICK, steps=10))
    rates = []
    for _ in range(10):
        training.advance()
        rates.append(training.optimizer.rates["means"])
    np.testing.assert_allclose(rates, MOST_PACE * 1.6e-4 * scene.extent * 0.01 ** (np.arange(10) / 10))


def test_all_rates_settle_at_the_end() -> None:
    training = _Training(synthetic(), replace(QUICK, steps=100))
    rates = []
    for training.step in range(101):
        now = training._rates(1)
        rates.append([float(torch.as_tensor(now[k]).flatten()[-1]) for k in ("quats", "log_scales", "opacity_logits", "sh")])
    falling = np.array(rates) / rates[0]
    np.testing.assert_allclose(falling[:71], 1.0)
    np.testing.assert_allclose(falling[-1], SETTLE_TO, rtol=1e-5)
    assert (np.diff(falling[70:], axis=0) < 0).all()


def test_fewer_steps_are_larger_ones_up_to_a_limit() -> None:
    def first_rates(steps: int) -> dict[str, float]:
        training = _Training(synthetic(), replace(QUICK, steps=steps))
        training.advance()
        return {name: float(torch.as_tensor(rate).flatten()[0]) for name, rate in training.optimizer.rates.items()}

    few, many, long, longer = (first_rates(steps) for steps in (50, RATES_STEPS // 4, RATES_STEPS, 10 * RATES_STEPS))
    assert long == longer == pytest.approx({**long, "log_scales": 5e-3, "opacity_logits": 5e-2, "quats": 1e-3, "sh": 2.5e-3})
    for name, rate in long.items():
        assert many[name] == pytest.approx(2 * rate) and few[name] == pytest.approx(MOST_PACE * rate), name


def test_the_background_starts_at_the_median_border_of_the_training_frames() -> None:
    scene = synthetic()
    grays = {f.name: 0.1 * (k + 1) for k, f in enumerate(scene.train_frames)} | {f.name: 1.0 for f in scene.held_out_frames}
    flat = with_images(scene, {name: np.full((40, 40, 3), gray, np.float32) for name, gray in grays.items()})
    background = _Training(flat, QUICK).frame_optimizer.parameters["background"]
    torch.testing.assert_close(background.detach(), torch.full((3,), 0.45))  # of 0.1, 0.2, …, 0.8


@pytest.mark.parametrize(("background", "expected"), [("black", 0.0), ("white", 1.0)])
def test_a_fixed_background_stays(background: str, expected: float) -> None:
    model = fit_rgb(synthetic(), replace(QUICK, steps=5, background=background))
    assert torch.equal(model.background, torch.full((3,), expected))


def test_coarse_levels_come_first_and_stop_at_48_pixels() -> None:
    scene = synthetic()
    config = replace(QUICK, steps=100, coarse_to_fine=((0.2, 4), (0.55, 2)))
    training = _Training(scene, config)
    assert [training.factor()] == [1]  # 40 px are few enough
    big = replace(CAMERA, width=200, height=192)
    rig = Rig(big, big, scene.rig.rgb_from_thermal)
    training.scene = replace(scene, capture=replace(scene.capture, rig=rig))
    factors = []
    for training.step in (0, 19, 20, 54, 56, 99):
        factors.append(training.factor())
    assert factors == [4, 4, 2, 2, 1, 1]
    small = training.image(scene.frames[1], 4)
    np.testing.assert_allclose(small, scene.frames[1].rgb.reshape(10, 4, 10, 4, 3).mean((1, 3)), atol=1e-6)


def test_bands_join_in_turn_over_the_first_half() -> None:
    training = _Training(synthetic(), replace(QUICK, steps=24, sh_degree=2))
    bands = []
    while training.step < 24:
        training.advance()
        bands.append(training.gaussians().sh_degree)
        assert training.model().gaussians.sh.shape[1:] == (9, 3)  # a model is always whole
    assert bands == [0] * 4 + [1] * 4 + [2] * 16
    assert training.gaussians().sh[:, 4:].detach().abs().max() > 0


# --- checkpoints -----------------------------------------------------------------------------------


@pytest.mark.parametrize("at", [7, 53])
def test_an_interrupted_run_continues_bit_for_bit(tmp_path: Path, at: int) -> None:
    scene, config, path = synthetic(), replace(QUICK, steps=80), tmp_path / "rgb.pt"
    whole = fit_rgb(scene, config)

    def interrupt(step: int, steps: int, text: str) -> None:
        if step == at:
            raise Interrupted

    with pytest.raises(Interrupted):
        fit_rgb(scene, config, checkpoint=path, progress=interrupt)
    assert [p.name for p in tmp_path.iterdir()] == ["rgb.pt"]
    steps: list[int] = []
    resumed = fit_rgb(scene, config, checkpoint=path, progress=lambda step, *_: steps.append(step))
    assert 1 < steps[0] <= at + 1 and steps[-1] == 80  # it did not start over
    assert_equal(whole, resumed)
    assert whole.history == resumed.history


def test_a_checkpoint_of_other_settings_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rgb.pt"
    fit_rgb(synthetic(), replace(QUICK, steps=3), checkpoint=path)
    with pytest.raises(RtgsError, match="other training settings"):
        fit_rgb(synthetic(), replace(QUICK, steps=3, seed=1), checkpoint=path)


def test_nothing_to_train_on_is_said() -> None:
    scene = synthetic()
    alone = assembled(list(scene.frames[:1]), {"000": scene.world_from_rgb["000"]}, scene.points)
    with pytest.raises(RtgsError, match="no training frame"):
        fit_rgb(alone, QUICK)
    # Without an extent the near plane and the position rate are zero, and every Gaussian is larger than the scene.
    turning = replace(scene, world_from_rgb={k: SE3(p.rotation, np.ones(3)) for k, p in scene.world_from_rgb.items()})
    with pytest.raises(RtgsError, match="one point"):
        fit_rgb(turning, QUICK)


# --- densification ---------------------------------------------------------------------------------


def trained() -> Adam:
    """Eight Gaussians after one step of Adam: 5 is faint, 6 larger than the scene, 7 not finite, 2 larger than a hundredth."""
    g = torch.Generator().manual_seed(0)
    parameters = {
        "means": torch.randn(8, 3, generator=g),
        "quats": torch.randn(8, 4, generator=g),
        "log_scales": torch.full((8, 3), math.log(0.001)),
        "opacity_logits": torch.zeros(8),
        "sh": torch.randn(8, 1, 3, generator=g),
    }
    optimizer = Adam(parameters, dict.fromkeys(parameters, 1e-3))
    sum((v * torch.randn(v.shape, generator=g)).sum() for v in optimizer.parameters.values()).backward()
    optimizer.step()
    with torch.no_grad():
        optimizer.parameters["log_scales"][2] = torch.tensor([0.1, 0.02, 0.001]).log()
        optimizer.parameters["opacity_logits"][5] = -8.0
        optimizer.parameters["log_scales"][6] = math.log(1.5)
        optimizer.parameters["means"][7, 1] = float("nan")
    return optimizer


def grow(target: int, wanted: list[float], seed: int = 0) -> tuple[Adam, int]:
    optimizer = trained()
    gradients = ScreenGradients(8)
    gradients.total = torch.tensor(wanted)
    gradients.count = torch.ones(8)
    n = densify(
        optimizer,
        gradients,
        DensifyConfig(),
        target=target,
        extent=1.0,
        generator=torch.Generator().manual_seed(seed),
        rotation_from_quats=rotation_from_quats,
    )
    return optimizer, n


WANTED = [1.0, 5.0, 4.0, 0.0, 2.0, 9.0, 9.0, 9.0]


@pytest.mark.parametrize(
    ("target", "sources"),
    [
        (0, [0, 1, 2, 3, 4]),  # over the target: pruned, none added
        (5, [0, 1, 2, 3, 4]),
        (6, [0, 1, 2, 3, 4, 1]),  # 1 is cloned
        (7, [0, 1, 3, 4, 1, 2, 2]),  # and 2 split
        (9, [0, 1, 3, 4, 1, 4, 0, 2, 2]),
        (100, [0, 1, 3, 4, 1, 4, 0, 2, 2]),  # 3 has no gradient
    ],
)
def test_a_round_prunes_clones_and_splits(target: int, sources: list[int]) -> None:
    before = trained().parameters
    optimizer, n = grow(target, WANTED)
    parameters = optimizer.parameters
    assert n == len(sources) and all(len(v) == n for v in parameters.values())
    for name in ("quats", "opacity_logits", "sh"):
        assert torch.equal(parameters[name], before[name][sources]), name
    whole = torch.tensor([s != 2 or 2 not in sources[-2:] for s in sources])
    index = torch.tensor(sources)
    for name in ("means", "log_scales"):
        assert torch.equal(parameters[name][whole], before[name][index[whole]]), name
    if not whole.all():  # the halves: 1.6 times smaller, drawn from their parent
        assert torch.allclose(parameters["log_scales"][~whole], before["log_scales"][2] - math.log(1.6))
        offsets = parameters["means"][~whole] - before["means"][2]
        assert offsets[0].norm() > 0 and not torch.equal(offsets[0], offsets[1])


def test_halves_are_samples_of_their_parent() -> None:
    # In the parent's own axes and sizes the offsets are standard normal.
    before = trained().parameters
    rotation = rotation_from_quats(before["quats"][2:3])[0]
    offsets = torch.stack(
        [grow(7, WANTED, seed)[0].parameters["means"][-2:] - before["means"][2] for seed in range(150)]
    ).reshape(-1, 3)
    standard = (offsets @ rotation) / before["log_scales"][2].exp()
    assert standard.mean(0).abs().max() < 0.25  # 300 samples: four standard errors
    assert (standard.std(0) - 1).abs().max() < 0.17


def test_moments_are_carried_over_and_those_of_new_gaussians_are_zero() -> None:
    old, (optimizer, _) = trained(), grow(7, WANTED)
    assert optimizer.steps == 1
    for name, parameter in optimizer.parameters.items():
        for moments, before in ((optimizer.first, old.first), (optimizer.second, old.second)):
            assert before[name].any() and torch.equal(moments[name][:4], before[name][[0, 1, 3, 4]])
            assert moments[name].shape == parameter.shape and not moments[name][4:].any()
    was = {name: parameter.detach().clone() for name, parameter in optimizer.parameters.items()}
    sum(v.sum() for v in optimizer.parameters.values()).backward()
    optimizer.step()  # the optimiser works on what is there now
    assert not any(torch.equal(parameter, was[name]) for name, parameter in optimizer.parameters.items())


def test_screen_gradients_are_the_mean_over_visible_views() -> None:
    gradients = ScreenGradients(3)
    gradients.add(torch.tensor([[3.0, 0.0], [0.0, 0.0], [0.1, 0.0]]), torch.tensor([True, True, False]), 20, 40)
    gradients.add(torch.tensor([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]), torch.tensor([True, False, False]), 20, 40)
    # Half the image: 3 · 10 = 30 along x, 1 · 20 = 20 along y.
    torch.testing.assert_close(gradients.mean(), torch.tensor([25.0, 0.0, 1.0]))


def test_the_schedule_reaches_the_budget_and_no_further() -> None:
    config = DensifyConfig(every=10, start=0.1, stop=0.5)
    counts = [target_count(config, 100, 1000, step, 1000) for step in range(0, 1001, 10)]
    assert counts[10] == 100 and counts[50] == 1000 and counts[-1] == 1000
    assert all(a <= b for a, b in itertools.pairwise(counts))
    assert target_count(config, 5000, 1000, 300, 1000) == 5000  # more points than the budget: the caller's choice
    assert [s for s in range(1001) if is_round(config, s, 1000)] == list(range(100, 501, 10))


# --- the start -------------------------------------------------------------------------------------


def test_points_become_gaussians_of_their_colour_and_spacing() -> None:
    xyz = np.stack(np.meshgrid(*[np.arange(6.0)] * 3), -1).reshape(-1, 3)
    rgb = np.random.default_rng(0).random((len(xyz), 3)).astype(np.float32)
    start = initial_gaussians(xyz, rgb, 2)
    assert start.sh.shape == (216, 9, 3)
    torch.testing.assert_close(start.sh[:, 0] * C0 + 0.5, torch.from_numpy(rgb))
    torch.testing.assert_close(start.log_scales, torch.zeros(216, 3))  # neighbours at distance 1
    torch.testing.assert_close(torch.sigmoid(start.opacity_logits), torch.full((216,), 0.1))
    scaled = initial_gaussians(xyz * 1e-3, rgb, 2)
    torch.testing.assert_close(scaled.log_scales, torch.full((216, 3), math.log(1e-3)))
    for few in (1, 2, 3):
        assert torch.isfinite(initial_gaussians(xyz[:few], rgb[:few], 0).log_scales).all()
    assert torch.isfinite(initial_gaussians(np.zeros((9, 3)), rgb[:9], 0).log_scales).all()  # duplicates


def test_the_budget_follows_the_picture_unless_it_is_given() -> None:
    assert budget(DensifyConfig(max_gaussians=77), 1_000_000, 500) == 77
    four = DensifyConfig(pixels_each=4.0)
    assert budget(four, 960 * 540, 500) == 129_600
    assert budget(replace(four, pixels_each=8.0), 960 * 540, 500) == 64_800
    assert budget(four, 100 * 100, 500) == 10_000
    assert budget(four, 100 * 100, 30_000) == 30_000
    assert budget(four, 4000 * 3000, 500) == 150_000


def test_a_quality_fills_in_what_is_left_open_and_nothing_else() -> None:
    plans = [RgbConfig(quality=quality).resolved() for quality in QUALITIES]
    steps = [plan.steps for plan in plans]
    assert steps == sorted(set(steps)) and all(plan.densify.pixels_each and plan.sh_degree for plan in plans)
    assert RgbConfig().resolved() == RgbConfig(quality="default").resolved() == plans[1]
    given = RgbConfig(quality="fast", steps=7, sh_degree=0, densify=DensifyConfig(max_gaussians=9, pixels_each=3.0))
    assert given.resolved() == given
    partly = RgbConfig(quality="best", steps=7).resolved()
    assert partly.steps == 7 and partly.densify == plans[2].densify
    model = fit_rgb(synthetic(), replace(QUICK, quality="fast", steps=3))
    assert model.history["step"][-1] == 3


def test_a_quality_or_a_number_of_steps_that_cannot_be_is_refused() -> None:
    with pytest.raises(RtgsError, match=r"rgb\.quality is 'good'; it is fast, default, best"):
        RgbConfig(quality="good")  # type: ignore[arg-type]
    with pytest.raises(RtgsError, match=r"rgb\.steps is 0"):
        RgbConfig(steps=0)


def test_a_damaged_checkpoint_is_named(tmp_path: Path) -> None:
    path = tmp_path / "rgb.checkpoint"
    path.write_bytes(b"half of it")  # as a power cut leaves it
    with pytest.raises(RtgsError, match=r"rgb\.checkpoint.*damaged.*remove it"):
        fit_rgb(synthetic(), QUICK, checkpoint=path)
