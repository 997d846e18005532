"""Huber's loss: its least value, eliminated offsets, columns that are solved together."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest
import torch
from tests.helpers.thermal_scenes import fit_of, outliers, ring

from rtgs.thermal.robust import solve_robustly


@pytest.mark.thorough
@pytest.mark.parametrize("offsets", [False, True])
def test_robust_solution_is_least_by_hubers_loss(offsets: bool) -> None:
    """By the loss's definition: nothing near it is less, its slope is gone, and no iteration raised it."""
    scene, rgb, _ = ring()
    fit, frames = fit_of(outliers(scene), rgb), range(12)
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
    assert torch.equal(solution.x, x) and solution.iterations == 0
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
    fit, frames = fit_of(outliers(scene), rgb), range(12)
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


def test_robust_columns_are_solved_together() -> None:
    """Each as if it were alone, under its own ridge, with and without offsets; a pixel of no weight changes nothing."""
    scene, rgb, _ = ring()
    fit, frames = fit_of(outliers(scene), rgb), range(1, 12)
    valid = fit.data.valid.clone()
    valid[:3] = 0.0
    fit = replace(fit, data=replace(fit.data, valid=valid))
    junk = replace(fit, data=replace(fit.data, images=tuple(y + 5.0 * (valid == 0) for y in fit.data.images)))
    offsets, factors = torch.tensor([1.0, 0.0, 1.0]), (1.0, 1.0, 30.0)
    start = fit.coverage.prior[:, None]
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
