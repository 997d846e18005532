"""The design matrix is what `render` draws, and its transpose is one."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.helpers.thermal_scenes import RIG, SFM_PER_METRE, fit_of, known, ring

from rtgs.maths.sh import coefficients
from rtgs.records.radiometry import LinearRange
from rtgs.thermal.colors import as_model
from rtgs.thermal.design import Design


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_design_is_what_render_draws_and_has_its_transpose(degree: int) -> None:
    """⟨A x, y⟩ = ⟨x, Aᵀ y⟩, and `as_model` shows A x whatever the sign of its colours."""
    scene, rgb, _ = known()
    fit = fit_of(scene, rgb, degree)
    design, g = fit.design, torch.Generator().manual_seed(degree)
    assert design.coefficients == coefficients(degree)
    x, y = torch.randn(design.size, 2, generator=g), torch.randn(30, 36, 2, generator=g)
    image, out = design.image(3, x), torch.zeros_like(x)
    design.add_transpose(lambda f: y, [3], out)
    torch.testing.assert_close((image * y).sum((0, 1)), (out * x).sum(0), rtol=1e-4, atol=1e-3)
    span = LinearRange(10.0, 20.0)
    for c in range(2):
        model = as_model(x[:, c : c + 1], design, rgb, unit="°C", scores=span, colors=span, sfm_per_metre=SFM_PER_METRE)
        np.testing.assert_allclose(model.render(RIG.thermal, fit.data.poses[3]), span.expand(image[..., c].numpy()), atol=1e-3)
        assert image[..., c].min() < -0.2  # below the range


def test_rows_of_photographs_are_those_of_the_camera() -> None:
    """`ThermalFrames.rows` and a design with `every` mean the same rows."""
    scene, rgb, _ = ring()
    fit = fit_of(scene, rgb)
    some, design = fit.data.rows(3), Design(rgb.gaussians, RIG.thermal, fit.data.poses, 1, rgb.settings, every=3)
    x = fit.coverage.prior[:, None]
    for f in (0, 5):
        torch.testing.assert_close(design.image(f, x), fit.design.image(f, x)[1::3], atol=2e-4, rtol=0)
        assert torch.equal(some.images[f], fit.data.images[f][1::3])
    assert torch.equal(some.valid, 3.0 * fit.data.valid[1::3])
