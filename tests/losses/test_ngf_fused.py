"""The fused NGF kernels against the torch loss in float64, and the laws of its residuals."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor

from rtgs.config import PAPER_EPSILON, PAPER_LEVEL_WEIGHTS
from rtgs.images.filters import SOBEL
from rtgs.losses.ngf import NgfPyramid, normalized_gradient
from rtgs.losses.ngf_fused import FusedNgf


def textured(height: int = 45, width: int = 58, seed: int = 0) -> Tensor:
    """Smoothed noise in [0, 1], float64."""
    smooth = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(height, width)), 1.5)
    return torch.from_numpy((smooth - smooth.min()) / np.ptp(smooth))


def holes(height: int = 45, width: int = 58) -> Tensor:
    mask = torch.ones(height, width, dtype=torch.bool)
    mask[5:9, 7:20] = False
    mask[-1] = False
    return mask


def pyramid(
    epsilon: float | tuple[float, ...],
    masked: bool,
    weights: tuple[float, ...] = PAPER_LEVEL_WEIGHTS,
    per_edge: bool = False,
    across: tuple[float, float] = SOBEL,
) -> NgfPyramid:
    image = torch.where(holes(), textured(seed=1), torch.tensor(torch.nan, dtype=torch.float64)) if masked else textured(seed=1)
    mask = holes() if masked else None
    return NgfPyramid.of(
        image, mask, level_weights=weights, epsilon=epsilon, render_epsilon=0.2, per_edge=per_edge, across=across
    )


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("epsilon", [PAPER_EPSILON, 0.2, (0.01, 0.1, 0.4)])
def test_the_residuals_squared_norm_is_eq_7(epsilon: float | tuple[float, ...], masked: bool) -> None:
    target, render = pyramid(epsilon, masked), textured(seed=2)
    residuals = target.residuals(render)
    assert residuals.square().sum().item() == pytest.approx(target(render).item(), abs=1e-12)
    assert target(render).item() > 0.1
    blank = torch.full_like(render, 0.4)
    assert target.residuals(blank).square().sum().item() == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("per_edge", [False, True])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize(
    "epsilon, across", [(PAPER_EPSILON, SOBEL), (0.2, SOBEL), ((0.01, 0.1, 0.4), SOBEL), (0.2, (0.75, 2.5)), (0.2, (0.0, 4.0))]
)
def test_kernels_equal_the_reference(
    epsilon: float | tuple[float, ...], across: tuple[float, float], masked: bool, per_edge: bool
) -> None:
    target, render = pyramid(epsilon, masked, per_edge=per_edge, across=across), textured(seed=2)
    tangents = torch.stack([textured(seed=s) - 0.5 for s in (3, 4, 5)])
    fused = FusedNgf.of(target)
    image, ways = render.float().numpy(), tangents.float().numpy()
    found = fused.products(image, ways)
    # float32 pictures; gradients of order 0.1 carry 1e-6.
    assert found.loss == pytest.approx(target(render).item(), abs=1e-5)
    assert fused.loss(image) == pytest.approx(found.loss, abs=1e-7)
    jacobian = torch.stack([torch.func.jvp(target.residuals, (render,), (t,))[1] for t in tangents])
    slopes = torch.stack([torch.func.jvp(target, (render,), (t,))[1] for t in tangents])
    assert slopes.abs().max() > 0.01
    np.testing.assert_allclose(found.slope, slopes, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(found.curvature, 2 * jacobian @ jacobian.T, rtol=1e-3, atol=1e-4)
    if per_edge:
        return
    # And the slope is what the residuals say.
    np.testing.assert_allclose(slopes, 2 * jacobian @ target.residuals(render), rtol=1e-6, atol=1e-9)


def test_directions_do_not_see_each_other() -> None:
    fused, image = FusedNgf.of(pyramid(0.05, True)), textured(seed=2).float().numpy()
    ways = np.stack([textured(seed=s).float().numpy() for s in range(3, 11)])
    together = fused.products(image, ways)
    for k in range(len(ways)):
        alone = fused.products(image, ways[k : k + 1])
        assert alone.slope[0] == pytest.approx(together.slope[k], rel=1e-5, abs=1e-7)
        assert alone.curvature[0, 0] == pytest.approx(together.curvature[k, k], rel=1e-5)
    np.testing.assert_array_equal(together.curvature, together.curvature.T)


@pytest.mark.parametrize("masked", [False, True])
def test_per_edge_is_the_mean_agreement_over_the_renders_own_strength(masked: bool) -> None:
    image, render, valid = textured(seed=1), textured(seed=2), holes() if masked else torch.ones(45, 58, dtype=torch.bool)
    n, m = (normalized_gradient(picture, 0.2) for picture in (render, image))
    inner = ndimage.binary_erosion(valid, np.ones((3, 3)), border_value=1)[1:-1, 1:-1]
    agreement, strength = ((n * m).sum(0) ** 2)[inner].mean(), n.square().sum(0)[inner].mean().sqrt()
    target = NgfPyramid.of(image, valid, level_weights=(1.0,), epsilon=0.2, per_edge=True)
    assert 0.1 < strength < 0.95
    assert target(render).item() == pytest.approx(1 - (agreement / strength).item(), abs=1e-12)


def test_per_edge_more_edge_is_no_merit_in_itself() -> None:
    """A render whose contrast grows falls in Eq. 6 for that alone; per edge it falls a good deal less."""
    image, render = textured(seed=1), textured(seed=2)
    falls = []
    for per_edge in (False, True):
        target = NgfPyramid.of(image, epsilon=0.2, per_edge=per_edge)
        weak, strong = (1 - target(render * contrast) for contrast in (1.0, 1.1))
        falls.append((strong / weak - 1).item())
    assert 0 < falls[1] < 0.7 * falls[0]


@pytest.mark.parametrize("per_edge", [False, True])
@pytest.mark.parametrize("level", [0.0, 0.37, 1.0])
def test_a_featureless_render_scores_exactly_one(level: float, per_edge: bool) -> None:
    fused = FusedNgf.of(NgfPyramid.of(textured(40, 52), per_edge=per_edge))
    blank = np.full((40, 52), level, np.float32)
    assert fused.loss(blank) == 1.0
    result = fused.products(blank, textured(40, 52).float().numpy()[None])
    assert result.loss == 1.0 and result.slope[0] == 0.0 and np.isfinite(result.curvature).all()


@pytest.mark.parametrize("per_edge", [False, True])
def test_levels_without_a_valid_pixel_cost_their_weight(per_edge: bool) -> None:
    nothing = torch.zeros(45, 58, dtype=torch.bool)
    target = NgfPyramid.of(textured(seed=1), nothing, epsilon=0.1, per_edge=per_edge)
    image = textured(seed=2)
    assert FusedNgf.of(target).loss(image.float().numpy()) == target(image).item() == 1.0
    assert target.residuals(image).square().sum().item() == pytest.approx(1.0)
