"""Temperatures and standard errors of single Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.helpers.thermal_scenes import RIG, SFM_PER_METRE, fit_of, fitted_ring, model_of, noisy, ring

from rtgs.maths.sh import C0
from rtgs.models import ThermalModel
from rtgs.records.scene import Scene
from rtgs.thermal import fit_thermal, gaussian_temperatures
from rtgs.thermal.certainty import Check
from rtgs.thermal.coverage import ridge
from rtgs.thermal.fit import Fit
from rtgs.thermal.least_squares import solve
from rtgs.thermal.settings import CertaintySettings, LinearSettings

NOISE_ALONE = CertaintySettings(calibrate=False)  # neighbours on the ring have nothing in common, as places of a surface have


def lightly_held(scene: Scene) -> tuple[Fit, ThermalModel]:
    """Fitted under a ridge too light to bias what is seen."""
    rgb = ring()[1]
    fit = fit_of(scene, rgb)
    problem = fit.problem((0.03,), range(len(fit.data)))
    x = solve(problem, problem.prior, iterations=80).x
    return fit, model_of(fit, x, scene, rgb)


@pytest.mark.thorough
def test_standard_error_is_that_of_repeated_noise() -> None:
    """Over noise drawn again and again: the scatter of the temperatures, and their distance from the truth."""
    runs = []
    for seed in range(12):
        scene = noisy(0.5, seed)
        runs.append(gaussian_temperatures(scene, lightly_held(scene)[1], settings=NOISE_ALONE))
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


@pytest.mark.thorough
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
    settings = LinearSettings()
    spread = np.concatenate([f.thermal.ravel() for f in scene.train_frames]).var()
    penalty = ridge(design, fit.coverage.pixels, settings.default_factor, settings).double()
    design.harmonics(penalty)[:, 0] = float(C0**2 * squares / (28 * 1080) / spread)
    penalty[-1] = float(squares / (28 * 1080) / spread)
    inverse = torch.linalg.inv(matrix + torch.diag(penalty))
    freedom = float((matrix * inverse).sum())
    blocks = torch.stack([inverse[k * i : k * (i + 1), k * i : k * (i + 1)] for i in range(n)])
    mean_basis = (seen[..., 0] / fit.coverage.pixels[:-1, None]).double()
    variance = torch.einsum("ni,nij,nj->n", mean_basis, blocks, mean_basis)
    exact = (squares / (28 * 1080 - freedom) * variance).sqrt().numpy()
    found = gaussian_temperatures(scene, model, settings=NOISE_ALONE)
    ratio = (found.std / exact)[found.views >= 14]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.15)
    assert np.quantile(ratio, 0.1) > 0.7 and np.quantile(ratio, 0.9) < 1.5  # eight samples


def test_what_no_view_sees_is_not_known() -> None:
    _, rgb, _ = ring()
    means = rgb.gaussians.means.clone()
    means[5] = torch.tensor([0.0, 0.0, 400.0])  # out of every view
    scene = noisy(0.5, 9)
    model = fit_thermal(scene, replace(rgb, gaussians=replace(rgb.gaussians, means=means)), SFM_PER_METRE)
    found = gaussian_temperatures(scene, model, settings=NOISE_ALONE)
    values = np.concatenate([f.thermal.ravel() for f in scene.train_frames])
    assert found.views[5] == 0 and 20 < found.views.max() <= 28
    assert found.temperature[5] == pytest.approx(values.mean(), abs=0.3)
    assert found.std[5] == pytest.approx(values.std(), rel=0.5)  # a sample of eight
    assert np.median(found.std[found.views >= 14]) < 0.1 * found.std[5]


def test_temperatures_are_what_the_views_see() -> None:
    scene, rgb, _ = ring()
    model = fitted_ring()
    found = gaussian_temperatures(scene, model)
    truth = ring()[2]
    true_c = truth.range.expand((0.5 + C0 * truth.gaussians.sh[:, 0, 0]).numpy())
    seen = found.views >= 14
    assert np.median(np.abs(found.temperature - true_c)[seen]) < 0.05
    assert (found.std > 0).all() and len(found.std) == len(rgb.gaussians)


def test_the_factor_is_by_how_much_differences_are_larger_than_standard_errors() -> None:
    generator, n = torch.Generator().manual_seed(0), 4000
    std = 0.1 + torch.rand(n, generator=generator)
    value, views, covered = torch.randn(n, generator=generator), torch.full((n,), 5.0), torch.full((n,), 4.0)
    squares, sigma = torch.full((n,), 2.0), 1.5
    noise = sigma * squares.sqrt() / covered  # of the mean over four pixels that it half covers
    for size in (0.7, 3.0):
        off = torch.randn(n, generator=generator) * size * (std.square() + noise.square()).sqrt()
        check = Check(covered, squares, covered * (value + off))
        assert check.factor(value, std, sigma, views, CertaintySettings()) == pytest.approx(size, rel=0.06)
        wrong = replace(check, shown=torch.where(torch.arange(n) < n // 2, check.shown + 100, check.shown))
        few = torch.where(torch.arange(n) < n // 2, 2.0, views)  # what too few views see does not count
        assert wrong.factor(value, std, sigma, few, CertaintySettings()) == pytest.approx(size, rel=0.08)
    assert check.factor(value, std, sigma, torch.zeros(n), CertaintySettings()) == 1.0
