"""Least squares: solutions, eliminated offsets and surfaces, columns that are solved together."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from tests.helpers.scene_record import altered
from tests.helpers.thermal_scenes import RIG, SFM_PER_METRE, changed, fit_of, known, model_of, ring

from rtgs.config import DriftKind
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.scene import Scene
from rtgs.thermal import gaussian_temperatures
from rtgs.thermal.drift import Drift
from rtgs.thermal.fit import Fit
from rtgs.thermal.least_squares import solve


def free_offsets(fit: Fit) -> tuple[DriftKind, Drift]:
    """Every frame's offset is solved for, from zero."""
    frames = len(fit.data)
    return "offset", Drift(fit.median, torch.ones(frames), torch.zeros(frames))


@pytest.mark.parametrize("offsets", [False, True])
def test_solution_satisfies_the_normal_equations(offsets: bool) -> None:
    scene, rgb, _ = known()
    fit = fit_of(scene, rgb)
    drift = free_offsets(fit) if offsets else None
    problem = fit.problem((1.0, 10.0, 100.0), range(8), drift=drift)
    start = torch.randn(fit.design.size, 3, generator=torch.Generator().manual_seed(1))
    solution = solve(problem, start, iterations=150)
    before, after = problem.gradient(start), problem.gradient(solution.x)
    assert (after.norm(dim=0) < 1e-5 * before.norm(dim=0)).all()
    assert (solution.residual < 1e-5).all() and solution.iterations == 150 and not solution.settled
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
        got = solve(one, one.prior, iterations=200).x
        torch.testing.assert_close(got.double(), exact, atol=2e-4, rtol=0)


def test_problems_with_and_without_offsets_are_solved_together() -> None:
    """Each as if it were alone."""
    scene, rgb, _ = ring()
    fit = fit_of(changed(scene, lambda i, t: t + 0.3 * (i % 5)), rgb)
    frames = range(len(fit.data))
    both = fit.problem((0.3, 0.3), frames, offsets=torch.tensor([0.0, 1.0]))
    start = both.prior.clone()
    pair = solve(both, start, iterations=6).x
    assert not torch.allclose(pair[:, 0], pair[:, 1], atol=1e-3)
    for c, drift in enumerate((None, free_offsets(fit))):
        alone = solve(fit.problem((0.3,), frames, drift=drift), start[:, :1], iterations=6).x
        torch.testing.assert_close(pair[:, c : c + 1], alone, atol=1e-4, rtol=0)


@pytest.mark.parametrize("offsets", [False, True])
def test_a_common_surface_is_eliminated_exactly(offsets: bool) -> None:
    """The gradient is that of photographs from which the best surface, and the best offsets beside it, have been taken by hand."""
    scene, rgb, _ = ring()
    fit, frames = fit_of(scene, rgb), range(8)
    g = torch.Generator().manual_seed(5)
    some = (torch.rand(fit.data.valid.shape, generator=g) > 0.2) * (0.2 + torch.rand(fit.data.valid.shape, generator=g))
    fit = replace(fit, data=replace(fit.data, valid=some))
    weights = fit.pixel_weights
    drift = free_offsets(fit) if offsets else None
    surface = fit.surface()
    problem = fit.problem((0.3,), frames, drift=drift, surface=surface)
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
def test_ridges_with_a_common_surface_are_solved_together(offsets: bool) -> None:
    scene, rgb, _ = ring()
    fit = fit_of(changed(scene, lambda i, t: t + 2.0 * np.linspace(-1, 1, t.shape[1]) ** 2), rgb)
    drift = free_offsets(fit) if offsets else None
    frames, surface = range(len(fit.data)), fit.surface()
    both = fit.problem((0.3, 3.0), frames, drift=drift, surface=surface)
    found = both.gradient(both.prior)
    for c, factor in enumerate((0.3, 3.0)):
        alone = fit.problem((factor,), frames, drift=drift, surface=surface)
        torch.testing.assert_close(found[:, c : c + 1], alone.gradient(alone.prior), atol=1e-3, rtol=1e-4)


def test_a_problem_without_the_surface_is_solved_together_with_those_that_have_it() -> None:
    """Each as if it were alone, with and without offsets; so does the settled answer."""
    scene, rgb, _ = ring()
    fit = fit_of(changed(scene, lambda i, t: t + 2.0 * np.linspace(-1, 1, t.shape[1]) ** 2 + 0.3 * (i % 5)), rgb)
    frames, surface = range(len(fit.data)), fit.surface()
    offsets, surfaces = torch.tensor([1.0, 1.0, 0.0]), torch.tensor([1.0, 0.0, 1.0])
    together = fit.problem((0.3,) * 3, frames, offsets=offsets, surface=surface, surfaces=surfaces)
    found = solve(together, together.prior, iterations=4).x
    for c in range(3):
        own = surface if surfaces[c] else None
        alone = fit.problem((0.3,), frames, offsets=offsets[c : c + 1], surface=own)
        torch.testing.assert_close(found[:, c : c + 1], solve(alone, alone.prior, iterations=4).x, atol=1e-4, rtol=0)
    assert not torch.allclose(found[:, 0], found[:, 1], atol=1e-2) and not torch.allclose(found[:, 0], found[:, 2], atol=1e-2)


def test_a_solved_problem_stays() -> None:
    scene, rgb, _ = known()
    problem = fit_of(scene, rgb).problem((10.0,), [0, 1])
    x = solve(problem, problem.prior, iterations=200).x
    again = solve(problem, x, iterations=3).x
    torch.testing.assert_close(again, x, atol=1e-4, rtol=0)


@lru_cache(maxsize=1)
def directional() -> tuple[Scene, RgbModel, ThermalModel]:
    """Known temperatures that depend on the direction; no clamp in what made them."""
    scene, rgb, truth = known()
    g = torch.Generator().manual_seed(5)
    sh = torch.cat([truth.gaussians.sh * 0.6, 0.15 * torch.randn(len(rgb.gaussians), 3, 1, generator=g)], dim=1)
    truth = replace(truth, gaussians=replace(truth.gaussians, sh=sh))
    images = {f.name: truth.render(RIG.thermal, scene.thermal_from_world(f.name, SFM_PER_METRE)) for f in scene.frames}
    return altered(scene, thermal=images), rgb, truth


def test_known_colours_are_recovered_to_a_millikelvin() -> None:
    scene, rgb, truth = directional()
    fit = fit_of(scene, rgb)
    problem = fit.problem((1e-6,), range(8))
    x = solve(problem, problem.prior, iterations=400).x
    model = model_of(fit, x, scene, rgb)
    for frame in scene.train_frames:
        pose = scene.thermal_from_world(frame.name, SFM_PER_METRE)
        np.testing.assert_allclose(model.render(RIG.thermal, pose), frame.thermal, atol=1e-3)
    seen = fit.coverage.pixels[:-1] > 60  # pixels over eight views: four numbers each
    assert seen.sum() > 30
    found, true = (gaussian_temperatures(scene, m).temperature[seen.numpy()] for m in (model, truth))
    np.testing.assert_allclose(found, true, atol=1e-3)
    assert float(model.color_range.expand(model.background.numpy())[0]) == pytest.approx(20.0, abs=1e-3)
