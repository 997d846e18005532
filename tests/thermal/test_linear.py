"""The thermal fit by least squares: its operator, its solver, what it recovers, and how sure it says it is."""

from __future__ import annotations

import importlib
import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Literal

import numpy as np
import pytest
import torch
from tests.thermal.test_adam import RIG, SFM_PER_METRE, assembled, held_out_error_c, known, with_thermal

from rtgs.config import ThermalConfig
from rtgs.maths.geometry import look_at
from rtgs.maths.sh import C0, basis, coefficients
from rtgs.models import RgbModel, ThermalModel
from rtgs.models.thermal import between
from rtgs.records.radiometry import LinearRange
from rtgs.records.scene import Scene
from rtgs.thermal import fit_thermal, gaussian_temperatures, training_range
from rtgs.thermal.design import Design
from rtgs.thermal.drift import Drift, estimate, in_gauge
from rtgs.thermal.frames import ThermalFrames
from rtgs.thermal.least_squares import solve
from rtgs.thermal.linear import DEFAULT_FACTOR, Fit, Judge, Watch, as_model, ridge
from rtgs.thermal.robust import solve_robustly

LINEAR = ThermalConfig()


@lru_cache(maxsize=1)
def ring() -> tuple[Scene, RgbModel, ThermalModel]:
    """The ball of `known`, seen from 32 places."""
    _, rgb, truth = known()
    poses = []
    for k in range(32):
        eye = SFM_PER_METRE * np.array([2.6 * math.cos(0.7 * k), 2.6 * math.sin(0.7 * k), 1.3 * math.sin(1.9 * k)])
        poses.append(look_at(eye, [0, 0, 0]))
    scene = assembled(poses, [np.zeros((RIG.thermal.height, RIG.thermal.width), np.float32)] * 32)
    images = {f.name: truth.render(RIG.thermal, scene.thermal_from_world(f.name, SFM_PER_METRE)) for f in scene.frames}
    return with_thermal(scene, images), rgb, truth


@lru_cache(maxsize=1)
def fitted() -> ThermalModel:
    scene, rgb, _ = ring()
    return fit_thermal(scene, rgb, SFM_PER_METRE, LINEAR)


def least_squares(scene: Scene, rgb: RgbModel, degree: int = 1) -> Fit:
    data = ThermalFrames.of(scene, scene.train_frames, SFM_PER_METRE, training_range(scene))
    design = Design(rgb.gaussians, RIG.thermal, data.poses, degree, rgb.settings)
    return Fit.of(design, data, 0.3)


def changed(scene: Scene, change: Callable[[int, np.ndarray], np.ndarray]) -> Scene:
    """Every thermal image replaced by `change(number of the frame, image)`."""
    return with_thermal(scene, {f.name: change(i, f.thermal).astype(np.float32) for i, f in enumerate(scene.capture.frames)})


# --- operator and solver ----------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_design_is_what_render_draws_and_has_its_transpose(degree: int) -> None:
    """⟨A x, y⟩ = ⟨x, Aᵀ y⟩, and `as_model` shows A x whatever the sign of its colours."""
    scene, rgb, _ = known()
    fit = least_squares(scene, rgb, degree)
    design, g = fit.design, torch.Generator().manual_seed(degree)
    assert design.coefficients == coefficients(degree)
    x, y = torch.randn(design.size, 2, generator=g), torch.randn(30, 36, 2, generator=g)
    image, out = design.image(3, x), torch.zeros_like(x)
    design.add_transpose(lambda f: y, [3], out)
    torch.testing.assert_close((image * y).sum((0, 1)), (out * x).sum(0), rtol=1e-4, atol=1e-3)
    span = LinearRange(10.0, 20.0)
    for c in range(2):
        model = as_model(x[:, c : c + 1], design, rgb, span, span, SFM_PER_METRE, {})
        np.testing.assert_allclose(model.render(RIG.thermal, fit.data.poses[3]), span.expand(image[..., c].numpy()), atol=1e-3)
        assert image[..., c].min() < -0.2  # below the range


@pytest.mark.parametrize("offsets", [False, True])
def test_solution_satisfies_the_normal_equations(offsets: bool) -> None:
    scene, rgb, _ = known()
    fit = least_squares(scene, rgb)
    drift = ("offset", Drift(0.3, torch.ones(8), torch.zeros(8))) if offsets else None
    problem = fit.problem((1.0, 10.0, 100.0), range(8), drift=drift)  # type: ignore[arg-type]
    start = torch.randn(fit.design.size, 3, generator=torch.Generator().manual_seed(1))
    solution = solve(problem, start, iterations=150)
    before, after = problem.gradient(start), problem.gradient(solution)
    assert (after.norm(dim=0) < 1e-5 * before.norm(dim=0)).all()
    # The same sum from its definition, by an independent route: a dense matrix of one problem.
    if not offsets:
        columns = []
        for d in range(fit.design.size):
            unit = torch.zeros(fit.design.size, 1)
            unit[d] = 1.0
            columns.append(fit.design.image(0, unit).flatten())
        dense = torch.stack(columns, dim=1).double()
        one = fit.problem((10.0,), [0])
        weights = one.weights[0].flatten().double()[:, None]
        matrix = dense.T @ (weights * dense) + torch.diag(one.ridge[:, 0].double())
        right = dense.T @ (weights * one.images[0].reshape(-1, 1).double()) + (one.ridge * one.prior).double()
        exact = torch.linalg.solve(matrix, right)
        got = solve(one, one.prior, iterations=200)
        torch.testing.assert_close(got.double(), exact, atol=2e-4, rtol=0)


def test_problems_with_and_without_offsets_go_side_by_side() -> None:
    """Each as if it were alone."""
    scene, rgb, _ = ring()
    fit = least_squares(changed(scene, lambda i, t: t + 0.3 * (i % 5)), rgb)
    frames = range(len(fit.data))
    both = fit.problem((0.3, 0.3), frames, offsets=torch.tensor([0.0, 1.0]))
    start = both.prior.clone()
    pair = solve(both, start, iterations=6)
    assert not torch.allclose(pair[:, 0], pair[:, 1], atol=1e-3)
    for c, drift in enumerate((None, ("offset", Drift(0.3, torch.ones(len(frames)), torch.zeros(len(frames)))))):
        alone = solve(fit.problem((0.3,), frames, drift=drift), start[:, :1], iterations=6)  # type: ignore[arg-type]
        torch.testing.assert_close(pair[:, c : c + 1], alone, atol=1e-4, rtol=0)


@pytest.mark.parametrize("offsets", [False, True])
def test_a_common_surface_is_eliminated_exactly(offsets: bool) -> None:
    """The gradient is that of photographs from which the best surface, and the best offsets beside it, have been taken by hand."""
    scene, rgb, _ = ring()
    fit, frames = least_squares(scene, rgb), range(8)
    g = torch.Generator().manual_seed(5)
    some = (torch.rand(fit.data.valid.shape, generator=g) > 0.2) * (0.2 + torch.rand(fit.data.valid.shape, generator=g))
    fit = replace(fit, data=replace(fit.data, valid=some))
    weights = fit.everywhere
    drift = ("offset", Drift(0.3, torch.ones(len(fit.data)), torch.zeros(len(fit.data)))) if offsets else None
    surface = fit.surface()
    problem = fit.problem((0.3,), frames, drift=drift, surface=surface)  # type: ignore[arg-type]
    x = problem.prior + 0.1 * torch.randn(problem.prior.shape, generator=g)
    left = [fit.data.images[f] - fit.design.image(f, x)[..., 0] for f in frames]
    columns = np.concatenate(
        [np.kron(np.ones((8, 1)), surface.reshape(-1, 5)), np.kron(np.eye(8), np.ones((surface[..., 0].numel(), 1)))], 1
    )
    columns = columns if offsets else columns[:, :5]
    root = torch.stack([weights[f] for f in frames]).sqrt().reshape(-1).double().numpy()
    target = torch.stack(left).reshape(-1).double().numpy()
    best, *_ = np.linalg.lstsq(root[:, None] * columns, root * target, rcond=None)
    rest = torch.from_numpy((target - columns @ best).astype(np.float32)).reshape(8, *surface.shape[:2])
    expected = -problem.ridge * (x - problem.prior)
    fit.design.add_transpose(lambda f: (weights[f] * rest[f])[..., None], frames, expected)
    found = problem.gradient(x)
    torch.testing.assert_close(found, expected, atol=2e-4 * float(expected.abs().max()), rtol=0)
    # And what conjugate gradients multiply with is minus the gradient's change.
    p = torch.randn(x.shape, generator=g)
    torch.testing.assert_close(
        problem.normal(p), found - problem.gradient(x + p), atol=2e-3 * float(problem.normal(p).abs().max()), rtol=0
    )


@pytest.mark.parametrize("offsets", [False, True])
def test_ridges_with_a_common_surface_go_side_by_side(offsets: bool) -> None:
    scene, rgb, _ = ring()
    fit = least_squares(changed(scene, lambda i, t: t + 2.0 * np.linspace(-1, 1, t.shape[1]) ** 2), rgb)
    drift = ("offset", Drift(0.3, torch.ones(len(fit.data)), torch.zeros(len(fit.data)))) if offsets else None
    frames, surface = range(len(fit.data)), fit.surface()
    both = fit.problem((0.3, 3.0), frames, drift=drift, surface=surface)  # type: ignore[arg-type]
    found = both.gradient(both.prior)
    for c, factor in enumerate((0.3, 3.0)):
        alone = fit.problem((factor,), frames, drift=drift, surface=surface)  # type: ignore[arg-type]
        torch.testing.assert_close(found[:, c : c + 1], alone.gradient(alone.prior), atol=1e-3, rtol=1e-4)


def test_what_a_surface_can_explain_is_no_error() -> None:
    """Whatever vignetting photographs have in common, the errors by which a ridge is chosen are the same; without the surface not."""
    scene, rgb, _ = ring()
    fit, frames = least_squares(scene, rgb), [1, 4, 7]
    surface, images = fit.surface(), [0.9 * fit.data.images[f] for f in frames]
    vignetting = surface @ torch.tensor([0.1, -0.2, 0.3, 0.2, -0.1])
    bent = fit.without(-vignetting)
    for kind in ("off", "offset"):
        was = fit.errors(kind, frames, images, surface)  # type: ignore[arg-type]
        torch.testing.assert_close(bent.errors(kind, frames, images, surface), was, rtol=1e-3, atol=0)  # type: ignore[arg-type]
        assert (bent.errors(kind, frames, images) > 1.2 * fit.errors(kind, frames, images)).all()  # type: ignore[arg-type]


def test_a_problem_without_the_surface_goes_beside_those_with_it() -> None:
    """Each as if it were alone, with and without offsets; so does the settled answer."""
    scene, rgb, _ = ring()
    fit = least_squares(changed(scene, lambda i, t: t + 2.0 * np.linspace(-1, 1, t.shape[1]) ** 2 + 0.3 * (i % 5)), rgb)
    frames, surface = range(len(fit.data)), fit.surface()
    offsets, surfaces = torch.tensor([1.0, 1.0, 0.0]), torch.tensor([1.0, 0.0, 1.0])
    together = fit.problem((0.3,) * 3, frames, offsets=offsets, surface=surface, surfaces=surfaces)
    found = solve(together, together.prior, iterations=4)
    for c in range(3):
        own = surface if surfaces[c] else None
        alone = fit.problem((0.3,), frames, offsets=offsets[c : c + 1], surface=own)
        torch.testing.assert_close(found[:, c : c + 1], solve(alone, alone.prior, iterations=4), atol=1e-4, rtol=0)
    assert not torch.allclose(found[:, 0], found[:, 1], atol=1e-2) and not torch.allclose(found[:, 0], found[:, 2], atol=1e-2)


@pytest.mark.parametrize("drift", ["offset", "auto"])
def test_one_row_of_several_leads_to_the_same(drift: Literal["offset", "auto"], monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there are many photographs: what some rows say leads where all of them lead; drift and vignetting go with it."""
    scene, rgb, _ = ring()
    vignetting = 1.5 * np.linspace(-1, 1, RIG.thermal.width) ** 2 + np.zeros((RIG.thermal.height, 1))
    capture = changed(scene, lambda i, t: t + vignetting + 0.8 * math.sin(0.4 * i))
    linear, errors = importlib.import_module("rtgs.thermal.linear"), []
    valid = torch.ones(RIG.thermal.height, RIG.thermal.width)
    assert linear.sampling(len(scene.train_frames), valid) == 1
    for most, every in ((linear.PIXELS, 1), (28 * valid.numel() // 3, 3)):
        monkeypatch.setattr(linear, "PIXELS", most)
        assert linear.sampling(28, valid) == every
        model = fit_thermal(capture, rgb, SFM_PER_METRE, ThermalConfig(drift=drift))
        assert model.drift and model.pattern is not None and model.pattern.shape == vignetting.shape
        assert (model.pattern - vignetting).std() < 0.1 * vignetting.std()
        errors.append(_differences(model, scene))
    assert errors[1] < 2.5 * errors[0] and errors[1] < 0.1


def test_how_many_rows_are_looked_at() -> None:
    linear, valid = importlib.import_module("rtgs.thermal.linear"), torch.ones(512, 640)
    assert linear.sampling(12, valid[:120, :160]) == 1
    assert linear.sampling(35, valid) == 4
    assert linear.sampling(5000, valid) == linear.MOST_ROWS
    valid[linear.MOST_ROWS // 2 :: linear.MOST_ROWS] = 0.0  # a mask that leaves none of these
    assert linear.sampling(5000, valid) == 1


def _differences(model: ThermalModel, scene: Scene) -> float:
    """Mean absolute error of the scene in held-out views, °C; the gauge is taken out."""
    left = []
    for frame in scene.held_out_frames:
        e = model.render(RIG.thermal, scene.thermal_from_world(frame.name, SFM_PER_METRE)) - frame.thermal
        left.append(np.abs(e - np.median(e)).mean())
    return float(np.mean(left))


def test_rows_of_photographs_are_those_of_the_camera() -> None:
    """`ThermalFrames.rows` and a design with `every` mean the same rows."""
    scene, rgb, _ = ring()
    fit = least_squares(scene, rgb)
    some, design = fit.data.rows(3), Design(rgb.gaussians, RIG.thermal, fit.data.poses, 1, rgb.settings, every=3)
    x = fit.evidence.prior[:, None]
    for f in (0, 5):
        torch.testing.assert_close(design.image(f, x), fit.design.image(f, x)[1::3], atol=2e-4, rtol=0)
        assert torch.equal(some.images[f], fit.data.images[f][1::3])
    assert torch.equal(some.valid, 3.0 * fit.data.valid[1::3])


def test_a_solved_problem_stays() -> None:
    scene, rgb, _ = known()
    problem = least_squares(scene, rgb).problem((10.0,), [0, 1])
    x = solve(problem, problem.prior, iterations=200)
    again = solve(problem, x, iterations=3)
    torch.testing.assert_close(again, x, atol=1e-4, rtol=0)


def outliers(scene: Scene) -> Scene:
    """One pixel in twenty is up to 20 °C off, and frames have offsets."""
    rng = np.random.default_rng(3)
    return changed(scene, lambda i, t: t + 0.3 * (i % 5) + np.where(rng.random(t.shape) < 0.05, rng.uniform(-20, 20, t.shape), 0))


@pytest.mark.parametrize("offsets", [False, True])
def test_robust_solution_is_least_by_hubers_loss(offsets: bool) -> None:
    """By the loss's definition: nothing near it is less, its slope is gone, and no iteration raised it."""
    scene, rgb, _ = ring()
    fit, frames = least_squares(outliers(scene), rgb), range(12)
    problem = fit.problem((10.0,), frames, offsets=torch.tensor([float(offsets)]))
    photographs = torch.stack([problem.images[f] for f in frames])

    def left(x: torch.Tensor) -> torch.Tensor:
        return photographs - torch.stack([fit.design.image(f, x) for f in frames])

    start = problem.prior.clone()
    mean = left(start).mean((1, 2), keepdim=True)
    bound = 0.3 * float((left(start) - offsets * mean).square().mean().sqrt())

    def without_levels(x: torch.Tensor) -> torch.Tensor:
        residual, levels = left(x), offsets * mean
        for _ in range(100 * offsets):
            weights = bound / (residual - levels).abs().clamp_min(bound)
            levels = (weights * residual).sum((1, 2), keepdim=True) / weights.sum((1, 2), keepdim=True)
        return residual - levels

    def loss(x: torch.Tensor) -> float:
        size = without_levels(x).abs().double()
        huber = torch.where(size < bound, size**2, 2 * bound * size - bound**2)
        return float(huber.sum() + (problem.ridge * (x - problem.prior).double() ** 2).sum())

    def slope(x: torch.Tensor) -> float:
        out = problem.ridge * (problem.prior - x)
        clamped = without_levels(x).clamp(-bound, bound)
        fit.design.add_transpose(lambda f: clamped[f], frames, out)
        return float(out.norm())

    losses = [loss(start)]

    def watch(x: torch.Tensor) -> bool:
        losses.append(loss(x))
        return False

    shown = [fit.design.image(f, start) for f in frames]
    x = solve_robustly(problem, start, huber=0.3, iterations=30, shown=shown, settled=watch).x
    assert all(after < before * (1 + 1e-6) for before, after in itertools.pairwise(losses))
    solution = solve_robustly(problem, x, huber=1.0, iterations=0, shown=[fit.design.image(f, x) for f in frames])
    assert torch.equal(solution.x, x)
    far = solve_robustly(problem, start, huber=0.3, iterations=300, shown=shown)
    assert slope(far.x) < 1e-3 * slope(start) and losses[-1] < 1.01 * loss(far.x)
    g = torch.Generator().manual_seed(2)
    for _ in range(3):
        assert loss(far.x + 1e-3 * torch.randn(far.x.shape, generator=g)) > loss(far.x)
    for f in frames:
        torch.testing.assert_close(far.shown(f), fit.design.image(f, far.x), atol=1e-4, rtol=0)
    expected = bound / without_levels(far.x).abs().clamp_min(bound)
    torch.testing.assert_close(torch.stack([far.weights(f) for f in frames]), expected, atol=5e-3, rtol=0)


def test_offsets_keep_up_with_the_colours() -> None:
    """From colours that are far too high: what the offsets take moves by as much as the images do, and weights are told from there."""
    scene, rgb, _ = ring()
    fit, frames = least_squares(outliers(scene), rgb), range(12)
    problem = fit.problem((1.0,), frames, offsets=torch.ones(1))
    start = problem.prior.clone()
    fit.design.harmonics(start)[:, 0] += 1.0
    shown = [fit.design.image(f, start) for f in frames]
    first = torch.stack([problem.images[f] - image for f, image in zip(frames, shown, strict=True)])
    bound = 0.3 * float((first - first.mean((1, 2), keepdim=True)).square().mean().sqrt())
    found = solve_robustly(problem, start, huber=0.3, iterations=2, shown=shown)
    for f in frames:
        left = problem.images[f] - found.shown(f)
        level = left.mean()
        for _ in range(100):
            weights = bound / (left - level).abs().clamp_min(bound)
            level = (weights * left).sum() / weights.sum()
        assert float((found.weights(f) - weights).abs().mean()) < 0.02


def test_robust_problems_go_side_by_side() -> None:
    """Each as if it were alone, under its own ridge, with and without offsets; a pixel of no weight changes nothing."""
    scene, rgb, _ = ring()
    fit, frames = least_squares(outliers(scene), rgb), range(1, 12)
    valid = fit.data.valid.clone()
    valid[:3] = 0.0
    fit = replace(fit, data=replace(fit.data, valid=valid))
    junk = replace(fit, data=replace(fit.data, images=tuple(y + 5.0 * (valid == 0) for y in fit.data.images)))
    offsets, factors = torch.tensor([1.0, 0.0, 1.0]), (1.0, 1.0, 30.0)
    start = fit.evidence.prior[:, None]
    shown = [fit.design.image(f, start) for f in frames]
    together = solve_robustly(fit.problem(factors, frames, offsets=offsets), start, huber=0.3, iterations=5, shown=shown)
    for c, factor in enumerate(factors):
        problem = junk.problem((factor,), frames, offsets=offsets[c : c + 1])
        problem = replace(
            problem, inverses=fit.problem(factors, frames).inverses, background=fit.problem(factors, frames).background
        )
        alone = solve_robustly(problem, start, huber=0.3, iterations=5, shown=shown)
        torch.testing.assert_close(together.x[:, c : c + 1], alone.x, atol=2e-4, rtol=0)
    assert not torch.allclose(together.x[:, 0], together.x[:, 1], atol=1e-2)
    with pytest.raises(ValueError, match="surface"):
        solve_robustly(fit.problem((1.0,), frames, surface=fit.surface()), start, huber=0.3, iterations=5, shown=shown)


# --- what it recovers -------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def directional() -> tuple[Scene, RgbModel, ThermalModel]:
    """Known temperatures that depend on the direction; no clamp in what made them."""
    scene, rgb, truth = known()
    g = torch.Generator().manual_seed(5)
    sh = torch.cat([truth.gaussians.sh * 0.6, 0.15 * torch.randn(len(rgb.gaussians), 3, 1, generator=g)], dim=1)
    truth = replace(truth, gaussians=replace(truth.gaussians, sh=sh))
    images = {f.name: truth.render(RIG.thermal, scene.thermal_from_world(f.name, SFM_PER_METRE)) for f in scene.frames}
    return with_thermal(scene, images), rgb, truth


def test_known_colours_are_recovered_to_a_millikelvin() -> None:
    scene, rgb, truth = directional()
    fit = least_squares(scene, rgb)
    problem = fit.problem((1e-6,), range(8))
    x = solve(problem, problem.prior, iterations=400)
    model = as_model(x, fit.design, rgb, training_range(scene), training_range(scene), SFM_PER_METRE, {})
    for frame in scene.train_frames:
        pose = scene.thermal_from_world(frame.name, SFM_PER_METRE)
        np.testing.assert_allclose(model.render(RIG.thermal, pose), frame.thermal, atol=1e-3)
    seen = fit.evidence.coverage[:-1] > 60  # pixels over eight views: four numbers each
    assert seen.sum() > 30
    found, true = (gaussian_temperatures(scene, m).temperature[seen.numpy()] for m in (model, truth))
    np.testing.assert_allclose(found, true, atol=1e-3)
    assert float(model.colors.expand(model.background.numpy())[0]) == pytest.approx(20.0, abs=1e-3)


def test_the_default_fit_finds_known_temperatures() -> None:
    scene, _, _ = ring()
    assert held_out_error_c(scene, fitted()) < 0.05  # of 30 °C; what is left is the ridge
    model = fitted()
    assert float(model.colors.expand(model.background.numpy())[0]) == pytest.approx(20.0, abs=0.02)
    assert len(model.history["step"]) == len(model.history["loss"]) > 1 and model.history["loss"][-1] < 3e-3


def test_geometry_and_opacity_stay_bit_for_bit() -> None:
    _, rgb, _ = ring()
    model = fitted()
    for name in ("means", "quats", "log_scales", "opacity_logits"):
        assert torch.equal(model.gaussians.tensors()[name], rgb.gaussians.tensors()[name]), name
    assert model.gaussians.sh.shape == (len(rgb.gaussians), 4, 1) and model.background.shape == (1,)
    assert model.range == training_range(ring()[0]) and model.sfm_per_metre == SFM_PER_METRE


def test_temperature_scale_does_not_matter() -> None:
    scene, rgb, _ = ring()
    counts = fit_thermal(changed(scene, lambda _, t: 100 * t + 27315), rgb, SFM_PER_METRE, ThermalConfig(drift="off"))
    pose = scene.thermal_from_world("000", SFM_PER_METRE)
    a, b = fitted().render(RIG.thermal, pose), counts.render(RIG.thermal, pose)
    np.testing.assert_allclose((b - 27315) / 100, a, atol=0.01)


def test_held_out_frames_change_nothing() -> None:
    scene, rgb, _ = ring()
    rng = np.random.default_rng(0)
    noise = {f.name: rng.uniform(-100, 900, f.thermal.shape).astype(np.float32) for f in scene.held_out_frames}
    a, b = (fit_thermal(s, rgb, SFM_PER_METRE, LINEAR) for s in (scene, with_thermal(scene, noise)))
    assert torch.equal(a.gaussians.sh, b.gaussians.sh) and torch.equal(a.background, b.background)
    assert a.range == b.range and a.history == b.history and a.drift == b.drift


def test_masked_pixels_change_nothing() -> None:
    scene, rgb, _ = ring()
    mask = np.ones((RIG.thermal.height, RIG.thermal.width), bool)
    mask[:, :4], mask[25:] = False, False
    models, sure = [], []
    for junk in (0.0, 400.0, math.nan):
        masked = with_thermal(changed(scene, lambda _, t: np.where(mask, t, junk)), {}, thermal_mask=mask)  # noqa: B023
        models.append(fit_thermal(masked, rgb, SFM_PER_METRE, LINEAR))
        sure.append(gaussian_temperatures(masked, models[-1]))
    for other, temperatures in zip(models[1:], sure[1:], strict=True):
        assert torch.equal(models[0].gaussians.sh, other.gaussians.sh)
        np.testing.assert_array_equal(sure[0].std, temperatures.std)
    assert torch.isfinite(models[0].gaussians.sh).all() and np.isfinite(sure[0].std).all()
    assert held_out_error_c(scene, models[0]) < 0.1


def test_temperatures_below_the_range_survive() -> None:
    """A cold spot that the 0.1 percentile leaves out: its colours are below the range, and nothing clamps them."""
    scene, rgb, truth = ring()
    cold = truth.gaussians.sh.clone()
    cold[7] = (-2.0 - 0.5) / C0  # −45 °C, through a renderer whose colour 0 is at −165 °C
    wide = replace(
        truth, gaussians=replace(truth.gaussians, sh=(0.5 + C0 * cold + 5.0) / 6.0 / C0 - 0.5 / C0),
        background=(truth.background + 5.0) / 6.0, range=LinearRange(15.0 - 150.0, 45.0),
    )  # fmt: skip
    images = {f.name: wide.render(RIG.thermal, scene.thermal_from_world(f.name, SFM_PER_METRE)) for f in scene.frames}
    scene = with_thermal(scene, images)
    lowest = min(float(i.min()) for i in images.values())
    model = fit_thermal(scene, rgb, SFM_PER_METRE, ThermalConfig(drift="off"))
    assert lowest < model.range.lo - 10.0  # there is something below the range to be lost
    assert held_out_error_c(scene, model) < 0.05
    directions = torch.nn.functional.normalize(torch.randn(4000, 3, generator=torch.Generator().manual_seed(3)), dim=1)
    colors = 0.5 + torch.einsum("dk,nk->nd", basis(directions, 1), model.gaussians.sh[..., 0])
    assert float(colors.min()) > 0.0 and model.colors.lo < lowest and model.colors.hi == model.range.hi
    deepest = min(
        float(model.render(RIG.thermal, scene.thermal_from_world(f.name, SFM_PER_METRE)).min()) for f in scene.train_frames
    )
    assert deepest == pytest.approx(min(float(f.thermal.min()) for f in scene.train_frames), abs=0.5)


def test_a_few_wrong_pixels_do_little() -> None:
    scene, rgb, _ = ring()
    rng = np.random.default_rng(2)
    dirty = changed(scene, lambda i, t: t if i % 8 == 0 else np.where(rng.random(t.shape) < 0.01, t + 60.0, t))
    clean_range = with_thermal(dirty, {})
    assert held_out_error_c(scene, fit_thermal(clean_range, rgb, SFM_PER_METRE, LINEAR)) < 0.3  # 0.6 °C on average in the images


@pytest.mark.parametrize("stop", [20, 100])
def test_progress_is_told_and_can_stop(stop: int) -> None:
    scene, rgb, _ = ring()
    calls: list[tuple[int, int]] = []

    def progress(done: int, total: int, text: str) -> None:
        calls.append((done, total))
        if len(calls) == stop:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_thermal(scene, rgb, SFM_PER_METRE, LINEAR, progress=progress)
    assert len(calls) == stop and all(0 < done < total for done, total in calls)
    texts: list[str] = []
    fit_thermal(scene, rgb, SFM_PER_METRE, LINEAR, progress=lambda done, total, text: texts.append(f"{done / total:g} {text}"))
    assert texts[-1].startswith("1 residual 0.0")


@pytest.mark.parametrize("drift", ["auto", "offset", "gain-offset"])
@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_few_frames(count: int, drift: Literal["auto", "offset", "gain-offset"]) -> None:
    scene, rgb, _ = ring()
    kept = [f.name for f in scene.train_frames][:count]
    some = replace(scene, world_from_rgb={n: scene.world_from_rgb[n] for n in kept})
    model = fit_thermal(some, rgb, SFM_PER_METRE, ThermalConfig(drift=drift))
    assert torch.isfinite(model.gaussians.sh).all() and bool(model.drift) == (drift != "auto")
    for frame in some.train_frames:
        shown = model.render(RIG.thermal, some.thermal_from_world(frame.name, SFM_PER_METRE), photographed_in=frame.name)
        assert np.abs(shown - frame.thermal).mean() < 0.3  # of 30 °C


@pytest.mark.parametrize(
    ("errors", "ends"),
    [
        ([[8.0, 9.0], [7.0, 8.0], [6.99, 7.99], [6.98, 7.98]], 4),  # all are settled
        ([[8.0, 9.0], [7.0, 8.5], [6.99, 8.2], [6.98, 7.9]], 4),  # the other falls, and would be behind if it fell as much again
        ([[8.0, 9.0], [7.0, 8.0], [6.99, 7.5], [6.98, 7.1]], None),  # would be ahead
        ([[8.0, 7.0], [7.0, 6.99], [6.5, 6.98], [6.0, 6.97]], None),  # the best itself still falls
    ],
)
def test_iterations_end_when_nothing_can_change_who_wins(
    errors: list[list[float]], ends: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    fit = least_squares(ring()[0], ring()[1])
    judge, turn = Judge(fit, [4]), itertools.count()
    monkeypatch.setattr(Judge, "errors", lambda self, kind, images: torch.tensor([errors[next(turn) // 2][kind]]))  # type: ignore[index]
    watch = Watch(judge, [0, 1], 0.02)  # type: ignore[list-item]
    x = fit.evidence.prior[:, None].expand(-1, 2)
    settled = [watch(x) for _ in errors]
    assert settled == [turn + 1 == ends for turn in range(len(errors))]


@pytest.mark.parametrize(("left", "there"), [(0.95, False), (0.85, True)])
def test_what_explains_little_is_no_pattern(left: float, there: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Faults of the geometry that stay in the same place of all pictures look like vignetting, and explain a twentieth of the error."""
    linear = importlib.import_module("rtgs.thermal.linear")
    scene, rgb, _ = ring()
    fit = least_squares(changed(scene, lambda i, t: t + 2.0 * np.linspace(-1, 1, t.shape[1]) ** 2), rgb)
    judge = Judge(fit, [4, 12, 20], fit.surface())
    seen = linear.look(judge, "auto")
    errors = torch.tensor([5.0, 5.1, 4.9])
    monkeypatch.setattr(Judge, "errors", lambda _, kind, images: errors * (1.0 if images is seen.without.images else left))
    assert linear.has_pattern(judge, seen) == there


def test_the_ridge_with_the_smallest_error_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """And what it leads to is its own: the weaker the ridge, the more view dependence."""
    linear, factors, sizes = importlib.import_module("rtgs.thermal.linear"), (30.0, 3.0, 0.3, 0.01), []
    fit = least_squares(ring()[0], ring()[1])
    judge, start = Judge(fit, [4, 12]), linear.Solved.of(fit, fit.evidence.prior[:, None])[0]
    monkeypatch.setattr(linear, "RIDGE_FACTORS", factors)
    for best in range(4):
        turn = itertools.count()
        monkeypatch.setattr(Judge, "errors", lambda *_, turn=turn, best=best: torch.tensor([1.0 + (next(turn) % 4 != best)]))
        factor, found = linear.choose_ridge(judge, "off", start)
        assert factor == factors[best]
        for image, expected in zip(found.images, fit.images(found.x), strict=True):  # of frames that were fitted, and were not
            torch.testing.assert_close(image, expected[..., 0], atol=1e-5, rtol=0)
        sizes.append(float(fit.design.harmonics(found.x)[:, 1:].norm()))
    assert all(1.05 * under_stronger < under_weaker for under_stronger, under_weaker in itertools.pairwise(sizes))


@pytest.mark.parametrize(("small", "threads"), [(1 << 30, 1), (0, 3)])
def test_small_pictures_get_one_thread(small: int, threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    design, seen, count = importlib.import_module("rtgs.thermal.design"), set(), [3]
    monkeypatch.setattr(design, "SMALL_PICTURE", small)
    monkeypatch.setattr(design.nb, "get_num_threads", lambda: count[0])
    monkeypatch.setattr(design.nb, "set_num_threads", lambda n: count.__setitem__(0, n))
    real = design.in_order
    monkeypatch.setattr(design, "in_order", lambda work, items, n, is_here: (seen.add(n), real(work, items, n, is_here))[1])
    scene, rgb, _ = ring()
    model = fit_thermal(scene, rgb, SFM_PER_METRE, LINEAR)
    gaussian_temperatures(scene, model)
    assert seen == {threads} and count == [3]


def test_eight_noisy_frames_get_a_ridge_that_suits_them() -> None:
    """One validation frame, which says both which ridge and when it is enough. A usual ridge is as good a bound as any."""
    rng, (scene, rgb, _) = np.random.default_rng(1), ring()
    noisy = changed(scene, lambda _, t: t + 0.05 * rng.standard_normal(t.shape))
    kept = [f.name for f in noisy.train_frames][:8]
    some = replace(noisy, world_from_rgb={n: noisy.world_from_rgb[n] for n in kept})
    model = fit_thermal(some, rgb, SFM_PER_METRE, LINEAR)
    fit = least_squares(some, rgb)
    x = solve(fit.problem((DEFAULT_FACTOR,), range(len(fit.data))), fit.evidence.prior[:, None], iterations=30)
    usual = as_model(x, fit.design, rgb, training_range(some), training_range(some), SFM_PER_METRE, {})
    assert _differences(model, scene) < 1.2 * _differences(usual, scene) < 0.5


def test_same_twice() -> None:
    scene, rgb, _ = ring()
    a, b = (fit_thermal(scene, rgb, SFM_PER_METRE, LINEAR) for _ in range(2))
    assert torch.equal(a.gaussians.sh, b.gaussians.sh) and torch.equal(a.background, b.background)


@pytest.mark.parametrize("kept_bytes", [2 << 30, 1_200_000, 300_000])
def test_threads_change_nothing(kept_bytes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor where seven of 28 views have their weights kept and the others their lists, or half of them nothing."""
    design = importlib.import_module("rtgs.thermal.design")
    scene, rgb, _ = ring()
    monkeypatch.setattr(Design.__init__, "__kwdefaults__", {"every": 1, "kept_bytes": kept_bytes})
    monkeypatch.setattr(design, "SMALL_PICTURE", 0)
    models = []
    for threads in (1, 3):
        monkeypatch.setattr(design.nb, "get_num_threads", lambda threads=threads: threads)
        monkeypatch.setattr(design.nb, "set_num_threads", lambda threads: None)
        models.append(fit_thermal(outliers(scene), rgb, SFM_PER_METRE, LINEAR))
    assert torch.equal(models[0].gaussians.sh, models[1].gaussians.sh) and models[0].drift == models[1].drift


# --- drift ------------------------------------------------------------------------------------------


def drifting(gains: bool) -> tuple[Scene, np.ndarray, np.ndarray]:
    """The known scene at 50 mK of noise, with offsets up to 1 °C and contrast up to 5 % about 22 °C."""
    rng = np.random.default_rng(4)
    offset, gain = rng.uniform(-1, 1, 32), 1 + 0.05 * gains * rng.uniform(-1, 1, 32)
    scene = changed(ring()[0], lambda i, t: 22 + offset[i] + gain[i] * (t - 22) + 0.05 * rng.standard_normal(t.shape))
    return scene, gain, offset


@pytest.mark.parametrize("gains", [False, True])
def test_drift_is_found_again(gains: bool) -> None:
    scene, gain, offset = drifting(gains)
    rgb = ring()[1]
    model = fit_thermal(scene, rgb, SFM_PER_METRE, LINEAR)
    names = [f.name for f in scene.train_frames]
    assert list(model.drift) == names
    found = np.array([model.drift[n] for n in names])
    train = [int(n) for n in names]
    at_22 = (found[:, 0] - 1) * 22 + found[:, 1]  # photograph less image where the image is 22 °C
    np.testing.assert_allclose(at_22 - np.median(at_22), offset[train] - np.median(offset[train]), atol=0.1)
    if gains:
        np.testing.assert_allclose(found[:, 0] / np.median(found[:, 0]), gain[train] / np.median(gain[train]), atol=0.015)
        assert np.median(np.log(found[:, 0])) == pytest.approx(0.0, abs=0.01)
    # Up to the gauge the model is that of the scene without drift; ignoring drift costs several times as much.
    without = _differences(fit_thermal(scene, rgb, SFM_PER_METRE, ThermalConfig(drift="off")), ring()[0])
    assert _differences(model, ring()[0]) < min(0.05, 0.2 * without)


def test_without_drift_none_is_modelled() -> None:
    rng = np.random.default_rng(6)
    noisy = changed(ring()[0], lambda _, t: t + 0.05 * rng.standard_normal(t.shape))
    model = fit_thermal(noisy, ring()[1], SFM_PER_METRE, LINEAR)
    assert model.drift == {} and model.pattern is None


def striped(drift_c: float) -> tuple[Scene, np.ndarray]:
    """The known scene at 50 mK of noise, seen by a sensor with readout stripes and vignetting, and offsets up to `drift_c`."""
    rng, (h, w) = np.random.default_rng(8), (RIG.thermal.height, RIG.thermal.width)
    y, x = np.linspace(-1, 1, h)[:, None], np.linspace(-1, 1, w)[None]
    pattern = 0.15 * rng.standard_normal((h, 1)) + 0.15 * rng.standard_normal((1, w)) + 0.6 * (2 / 3 - x**2 - y**2)
    offset = rng.uniform(-drift_c, drift_c, 32)
    scene = changed(ring()[0], lambda i, t: t + pattern + offset[i] + 0.05 * rng.standard_normal(t.shape))
    return scene, pattern


@pytest.mark.parametrize("drift_c", [0.0, 1.0])
def test_a_sensors_pattern_is_told_from_the_scene(drift_c: float) -> None:
    (scene, pattern), rgb = striped(drift_c), ring()[1]
    model = fit_thermal(scene, rgb, SFM_PER_METRE, LINEAR)
    assert model.pattern is not None and model.pattern.dtype == np.float32
    assert bool(model.drift) == (drift_c > 0)
    assert (model.pattern - pattern).std() < 0.3 * pattern.std()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(importlib.import_module("rtgs.thermal.linear"), "has_pattern", lambda *_: False)
        ignored = fit_thermal(scene, rgb, SFM_PER_METRE, LINEAR)
    assert ignored.pattern is None
    photographs, truths = [], []
    for m in (model, ignored):
        errors = []
        for frame, clean in zip(scene.held_out_frames, ring()[0].held_out_frames, strict=True):
            pose = scene.thermal_from_world(frame.name, SFM_PER_METRE)
            away = (
                m.render(RIG.thermal, pose, photographed_in=frame.name) - frame.thermal,
                m.render(RIG.thermal, pose) - clean.thermal,
            )
            errors.append([np.abs(e - np.median(e)).mean() for e in away])
        photograph, truth = np.mean(errors, axis=0)
        photographs.append(photograph)
        truths.append(truth)
    assert photographs[0] < 0.6 * photographs[1] and truths[0] < 0.6 * truths[1]


def test_a_pattern_belongs_to_its_sensor() -> None:
    model = replace(fitted(), pattern=np.full((RIG.thermal.height, RIG.thermal.width), 0.25, np.float32))
    pose = ring()[0].thermal_from_world("003", SFM_PER_METRE)
    plain = fitted().render(RIG.thermal, pose)
    np.testing.assert_allclose(model.render(RIG.thermal, pose), plain)
    np.testing.assert_allclose(model.render(RIG.thermal, pose, photographed_in="003"), plain + 0.25, atol=1e-4)
    with pytest.raises(ValueError, match="pattern"):
        model.render(RIG.thermal.resized(16, 16), pose, photographed_in="003")


def test_gauge() -> None:
    g = torch.Generator().manual_seed(0)
    images = [torch.rand(9, 7, generator=g) for _ in range(5)]
    drift = Drift(0.4, torch.tensor([0.8, 1.1, 1.3, 1.2, 0.9]), torch.tensor([0.1, -0.3, 0.2, 0.4, 0.0]))
    photographs = [drift.of(f, i) for f, i in enumerate(images)]
    found = estimate("gain-offset", 0.4, images, photographs, [torch.ones(9, 7)] * 5)
    torch.testing.assert_close(found.gain, drift.gain, atol=1e-4, rtol=0)
    torch.testing.assert_close(found.offset, drift.offset, atol=1e-4, rtol=0)
    fixed, gain, offset = in_gauge(drift)
    assert float(fixed.gain.log().median()) == pytest.approx(0.0, abs=1e-6)
    assert float(fixed.offset.median()) == pytest.approx(0.0, abs=1e-6)
    for f, image in enumerate(images):  # photographs stay what they were
        torch.testing.assert_close(fixed.of(f, 0.4 + offset + gain * (image - 0.4)), photographs[f], atol=1e-6, rtol=0)


# --- certainty --------------------------------------------------------------------------------------


def noisy(sigma_c: float, seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    return changed(ring()[0], lambda _, t: t + sigma_c * rng.standard_normal(t.shape))


def lightly_held(scene: Scene) -> tuple[Fit, ThermalModel]:
    """Fitted under a ridge too light to bias what is seen."""
    rgb = ring()[1]
    fit = least_squares(scene, rgb)
    problem = fit.problem((0.03,), range(len(fit.data)))
    x = solve(problem, problem.prior, iterations=80)
    return fit, as_model(x, fit.design, rgb, training_range(scene), training_range(scene), SFM_PER_METRE, {})


def test_standard_error_is_that_of_repeated_noise() -> None:
    """Over noise drawn again and again: the scatter of the temperatures, and their distance from the truth."""
    runs = []
    for seed in range(12):
        scene = noisy(0.5, seed)
        runs.append(gaussian_temperatures(scene, lightly_held(scene)[1]))
    truth = ring()[2]
    true_c = truth.range.expand((0.5 + C0 * truth.gaussians.sh[:, 0, 0]).numpy())
    found = np.array([r.temperature for r in runs])
    scatter, error = np.std(found, axis=0, ddof=1), np.sqrt(np.mean((found - true_c) ** 2, axis=0))
    stated = np.sqrt(np.mean([r.std.astype(np.float64) ** 2 for r in runs], axis=0))
    seen = runs[0].views >= 14
    assert seen.sum() > 100
    assert np.median(stated[seen] / scatter[seen]) == pytest.approx(1.0, abs=0.2)
    assert np.median(stated[seen] / error[seen]) == pytest.approx(1.0, abs=0.2)
    assert np.corrcoef(np.log(stated[seen]), np.log(scatter[seen]))[0, 1] > 0.8  # it tells the sure from the unsure


def test_standard_error_is_the_inverse_matrixs() -> None:
    """Samples and blocks against the inverse of the whole matrix."""
    scene = noisy(0.5, 1)
    fit, model = lightly_held(scene)
    design, n, k = fit.design, fit.design.gaussians, fit.design.coefficients
    matrix = torch.zeros(design.size, design.size, dtype=torch.float64)
    unit, seen, squares = torch.eye(design.size), torch.zeros(n, k, 1), 0.0
    for f, frame in enumerate(scene.train_frames):
        columns = [design.image(f, part.contiguous()).flatten(0, 1) for part in unit.split(8, dim=1)]
        dense = torch.cat(columns, dim=1).double()
        matrix += dense.T @ dense
        design.add_harmonics(f, design.weights(f, torch.ones(30, 36, 1))[0], seen)
        squares += float(((model.render(RIG.thermal, fit.data.poses[f]) - frame.thermal) ** 2).sum())
    spread = np.concatenate([f.thermal.ravel() for f in scene.train_frames]).var()
    penalty = ridge(design, fit.evidence.coverage, DEFAULT_FACTOR).double()
    design.harmonics(penalty)[:, 0] = float(C0**2 * squares / (28 * 1080) / spread)
    penalty[-1] = float(squares / (28 * 1080) / spread)
    inverse = torch.linalg.inv(matrix + torch.diag(penalty))
    freedom = float((matrix * inverse).sum())
    blocks = torch.stack([inverse[k * i : k * (i + 1), k * i : k * (i + 1)] for i in range(n)])
    mean_basis = (seen[..., 0] / fit.evidence.coverage[:-1, None]).double()
    variance = torch.einsum("ni,nij,nj->n", mean_basis, blocks, mean_basis)
    exact = (squares / (28 * 1080 - freedom) * variance).sqrt().numpy()
    found = gaussian_temperatures(scene, model)
    ratio = (found.std / exact)[found.views >= 14]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.15)
    assert np.quantile(ratio, 0.1) > 0.7 and np.quantile(ratio, 0.9) < 1.5  # eight samples


def test_what_no_view_sees_is_not_known() -> None:
    _, rgb, _ = ring()
    means = rgb.gaussians.means.clone()
    means[5] = torch.tensor([0.0, 0.0, 400.0])  # out of every view
    scene = noisy(0.5, 9)
    model = fit_thermal(scene, replace(rgb, gaussians=replace(rgb.gaussians, means=means)), SFM_PER_METRE, LINEAR)
    found = gaussian_temperatures(scene, model)
    values = np.concatenate([f.thermal.ravel() for f in scene.train_frames])
    assert found.views[5] == 0 and 20 < found.views.max() <= 28
    assert found.temperature[5] == pytest.approx(values.mean(), abs=0.3)
    assert found.std[5] == pytest.approx(values.std(), rel=0.5)  # a sample of eight
    assert np.median(found.std[found.views >= 14]) < 0.1 * found.std[5]


def test_temperatures_are_what_the_views_see() -> None:
    scene, rgb, _ = ring()
    model = fitted()
    found = gaussian_temperatures(scene, model)
    truth = ring()[2]
    true_c = truth.range.expand((0.5 + C0 * truth.gaussians.sh[:, 0, 0]).numpy())
    seen = found.views >= 14
    assert np.median(np.abs(found.temperature - true_c)[seen]) < 0.05
    assert (found.std > 0).all() and len(found.std) == len(rgb.gaussians)


def test_a_held_out_frame_has_the_drift_of_its_neighbours_as_far_as_they_agree() -> None:
    slow = np.sin(np.arange(40) / 6.0)[:, None] * (0.0, 2.0)
    between_them = between(slow, slow[:, 1], 11)
    assert between_them[1] == pytest.approx(slow[10:12, 1].mean(), rel=0.06) and between_them[0] == 0.0
    wild = np.random.default_rng(1).normal(size=(400, 2))
    assert np.abs(between(wild, wild[:, 1], 200)).max() < 0.15
    assert between(slow, slow[:, 1], 0)[1] == pytest.approx(slow[0, 1], abs=0.1)
    assert between(slow, slow[:, 1], 40)[1] == pytest.approx(slow[39, 1], rel=0.06)
