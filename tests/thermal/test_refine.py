"""Geometry that is fitted to thermal images comes closer to the geometry that they show."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.helpers.thermal_scenes import RIG, fit_of, ring

from rtgs.records.gaussians import Gaussians
from rtgs.thermal.design import Design
from rtgs.thermal.fit import Fit, Fitted
from rtgs.thermal.least_squares import solve
from rtgs.thermal.refine import Geometry, refined


def error(fit: Fit, shown: Fitted) -> float:
    return float(torch.stack([(y - i).abs().mean() for y, i in zip(fit.data.images, shown.images, strict=True)]).mean())


@pytest.mark.thorough
@pytest.mark.parametrize("every", [1, 2])
def test_sizes_and_places_come_closer_to_the_truth(every: int) -> None:
    """The Gaussians start a third too large, and displaced by a sixth of their size. They themselves are not changed."""
    scene, rgb, _ = ring()
    truth, generator = rgb.gaussians, torch.Generator().manual_seed(3)
    away = 0.16 * truth.log_scales.exp().mean() * torch.randn(truth.means.shape, generator=generator)
    wrong = replace(truth, means=truth.means + away, log_scales=truth.log_scales + 0.3)
    kept = {name: value.clone() for name, value in wrong.tensors().items()}

    fit = fit_of(scene, replace(rgb, gaussians=wrong))
    data = fit.data.rows(every)

    def design(gaussians: Gaussians) -> Design:
        return Design(gaussians, RIG.thermal, data.poses, 1, rgb.settings, every=every)

    fit = Fit.of(design(wrong), data, fit.settings)
    frames = range(len(data))
    x = solve(fit.problem((0.3,), frames), fit.coverage.prior[:, None], iterations=20).x
    (before,) = Fitted.of(fit, x)
    geometry = Geometry(wrong, RIG.thermal, every, scene.extent, True, rgb.settings, design)
    moved, x = refined(fit, geometry, x, fit.drift("off", before.images), frames)
    (after,) = Fitted.of(replace(fit, design=design(moved)), x)

    # Shapes are not seen well along the rays, and Gaussians inside the ball hardly at all.
    assert error(fit, after) < 0.85 * error(fit, before)
    assert float((moved.log_scales - truth.log_scales).abs().mean()) < 0.85 * 0.3
    assert float((moved.means - truth.means).norm(dim=1).mean()) < float(away.norm(dim=1).mean())
    assert all(torch.equal(value, kept[name]) for name, value in wrong.tensors().items())
