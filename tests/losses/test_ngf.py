"""The normalised gradient field loss as one writes it down: Eqs. 5–7 against plain loops."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from tests.helpers.gradients import gradient_of
from tests.helpers.textures import holes, ramp, textured
from torch import Tensor

from rtgs.config import PAPER_EPSILON, PAPER_LEVEL_WEIGHTS
from rtgs.images.filters import downsample, sobel
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.losses.ngf import NgfPyramid, ngf_loss, normalized_gradient


def naive_ngf(a: Tensor, b: Tensor, epsilon: float, mask: Tensor | None = None) -> float:
    """Eqs. 5 and 6, one pixel at a time."""
    kernel = np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]])
    height, width = a.shape
    terms = []
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            if mask is not None and not mask[y - 1 : y + 2, x - 1 : x + 2].all():
                continue
            n = []
            for image in (a.numpy(), b.numpy()):
                patch = image[y - 1 : y + 2, x - 1 : x + 2]
                gradient = np.array([(patch * kernel).sum(), (patch * kernel.T).sum()])
                n.append(gradient / np.sqrt(gradient @ gradient + epsilon**2))
            terms.append(1.0 - (n[0] @ n[1]) ** 2)
    return float(np.mean(terms))


@pytest.mark.parametrize("epsilon", [PAPER_EPSILON, 0.3])
def test_normalised_gradient_is_shorter_than_one(epsilon: float) -> None:
    image = textured(24, 31)
    n = normalized_gradient(image, epsilon)
    gx, gy = sobel(image)
    length = torch.hypot(gx, gy)
    # Eq. 5: the direction of ∇I, and the length ‖∇I‖ / √(‖∇I‖² + ε²) < 1.
    torch.testing.assert_close(n.norm(dim=0), length / torch.sqrt(length**2 + epsilon**2))
    torch.testing.assert_close(n[0] * gy, n[1] * gx)
    assert (n.norm(dim=0) < 1).all() and (n[0] * gx >= 0).all()
    assert not normalized_gradient(torch.full((5, 5), 0.7), epsilon).any()


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("epsilon", [PAPER_EPSILON, 0.2])
def test_loss_equals_a_loop_over_pixels(epsilon: float, masked: bool) -> None:
    a, b = textured(24, 31, seed=1), textured(24, 31, seed=2)
    mask = torch.rand(a.shape, generator=torch.Generator().manual_seed(0)) > 0.05 if masked else None
    expected = naive_ngf(a, b, epsilon, mask)
    assert 0.1 < expected < 0.95
    assert ngf_loss(a, b, epsilon=epsilon, mask=mask).item() == pytest.approx(expected, abs=1e-12)
    # float32: gradients of order 0.1 carry 1e-6, so do their directions; the mean over 600 pixels is no worse.
    assert ngf_loss(a.float(), b.float(), epsilon=epsilon, mask=mask).item() == pytest.approx(expected, abs=1e-5)


def test_the_same_image_costs_nothing() -> None:
    image = textured(24, 31)
    assert ngf_loss(image, image).item() < 1e-6
    assert NgfPyramid.of(image)(image).item() < 1e-6


@pytest.mark.parametrize("change", [lambda x: 1.0 - x, lambda x: 0.3 * x + 0.5, lambda x: -7.0 * x])
def test_inversion_and_affine_changes_cost_nothing(change: Callable[[Tensor], Tensor]) -> None:
    a, b = textured(24, 31, seed=1), textured(24, 31, seed=2)
    assert ngf_loss(change(b), b).item() < 1e-6
    # Gradients of this image are above 1e-3 nearly everywhere, a thousand times the paper's ε.
    assert ngf_loss(change(a), b).item() == pytest.approx(ngf_loss(a, b).item(), abs=1e-5)
    assert NgfPyramid.of(b)(change(a)).item() == pytest.approx(NgfPyramid.of(b)(a).item(), abs=1e-5)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("level", [0.0, 0.37, 1.0])
def test_a_featureless_render_scores_exactly_one(level: float, dtype: torch.dtype) -> None:
    image, blank = textured(40, 52).to(dtype), torch.full((40, 52), level, dtype=dtype)
    assert ngf_loss(blank, image).item() == 1.0
    assert ngf_loss(image, blank).item() == 1.0
    assert NgfPyramid.of(image)(blank).item() == 1.0
    assert NgfPyramid.of(image, settings=EdgeLoss((1.0, 0.3, 0.7, 0.1)))(blank).item() == 1.0


def test_a_blank_render_gives_a_finite_gradient() -> None:
    blank = torch.full((40, 52), 0.37, requires_grad=True)
    NgfPyramid.of(textured(40, 52).float())(blank).backward()
    assert torch.isfinite(gradient_of(blank)).all()


def test_orthogonal_gradients_cost_one() -> None:
    assert ngf_loss(ramp(12, 15, (1, 2)), ramp(12, 15, (-2, 1))).item() == pytest.approx(1.0, abs=1e-12)
    # At 45° the dot product is √½.
    assert ngf_loss(ramp(12, 15, (1, 0)), ramp(12, 15, (1, 1))).item() == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize("garbage", [3.0, float("nan"), float("inf")])
def test_masked_pixels_of_the_target_are_not_looked_at(garbage: float) -> None:
    a, b = textured(40, 52, seed=1), textured(40, 52, seed=2)
    mask = torch.ones(40, 52, dtype=torch.bool)
    mask[13:21, 30:] = False
    spoiled = torch.where(mask, b, torch.full_like(b, garbage))
    assert ngf_loss(a, spoiled, mask=mask).item() == ngf_loss(a, b, mask=mask).item()
    assert NgfPyramid.of(spoiled, mask)(a).item() == NgfPyramid.of(b, mask)(a).item()
    assert NgfPyramid.of(b, mask)(a).item() != NgfPyramid.of(b)(a).item()


def test_masked_pixels_of_the_render_are_not_looked_at() -> None:
    a, b = textured(40, 52, seed=1), textured(40, 52, seed=2)
    mask = torch.ones(40, 52, dtype=torch.bool)
    mask[13:21, 30:] = False
    changed = torch.where(mask, a, 1.0 - 3.0 * a.flip(0)).requires_grad_()
    assert ngf_loss(changed, b, mask=mask).item() == ngf_loss(a, b, mask=mask).item()
    loss = NgfPyramid.of(b, mask)(changed)
    assert loss.item() == NgfPyramid.of(b, mask)(a).item()
    loss.backward()
    assert not gradient_of(changed)[~mask].any() and gradient_of(changed)[mask].any()


def test_nothing_left_by_the_mask_scores_one() -> None:
    image, nothing = textured(24, 31), torch.zeros(24, 31, dtype=torch.bool)
    assert ngf_loss(image, image, mask=nothing).item() == 1.0
    assert NgfPyramid.of(image, nothing)(image).item() == 1.0


def test_pyramid_is_the_weighted_mean_of_its_levels() -> None:
    assert PAPER_LEVEL_WEIGHTS == (1.0, 0.5, 0.25)  # w_l = 0.5^l: the finest weighs most, as printed
    a, b = textured(40, 52, seed=1), textured(40, 52, seed=2)
    levels = [naive_ngf(downsample(a, f), downsample(b, f), PAPER_EPSILON) for f in (1, 2, 4)]
    assert max(levels) - min(levels) > 0.01  # another order of the weights would show
    assert NgfPyramid.of(b)(a).item() == pytest.approx((levels[0] + 0.5 * levels[1] + 0.25 * levels[2]) / 1.75, abs=1e-9)
    other = NgfPyramid.of(b, settings=EdgeLoss((0.2, 3.0), epsilon=0.1))(a).item()
    levels = [naive_ngf(downsample(a, f), downsample(b, f), 0.1) for f in (1, 2)]
    assert other == pytest.approx((0.2 * levels[0] + 3.0 * levels[1]) / 3.2, abs=1e-12)
    assert NgfPyramid.of(b, settings=EdgeLoss((5.0,)))(a).item() == pytest.approx(ngf_loss(a, b).item(), abs=1e-12)


def test_gradient_equals_finite_differences() -> None:
    # ε of the size of the gradients: with the paper's 1e-6 the loss turns within 1e-6 of grey value wherever the image is flat,
    # and no finite difference can follow.
    a, b = textured(12, 13, seed=1), textured(12, 13, seed=2)
    mask = torch.ones(12, 13, dtype=torch.bool)
    mask[5, 6] = False
    pyramid = NgfPyramid.of(b, mask, EdgeLoss((1.0, 0.5), epsilon=0.1))
    assert torch.autograd.gradcheck(pyramid, a.requires_grad_())
    assert torch.autograd.gradcheck(lambda x: ngf_loss(x, b, epsilon=0.1, mask=mask), a)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("epsilon", [PAPER_EPSILON, 0.2, (0.01, 0.1, 0.4)])
def test_the_residuals_squared_norm_is_eq_7(epsilon: float | tuple[float, ...], masked: bool) -> None:
    target = NgfPyramid.of(textured(seed=1), holes() if masked else None, EdgeLoss(epsilon=epsilon, render_epsilon=0.2))
    render = textured(seed=2)
    residuals = target.residuals(render)
    assert residuals.square().sum().item() == pytest.approx(target(render).item(), abs=1e-12)
    assert target(render).item() > 0.1
    blank = torch.full_like(render, 0.4)
    assert target.residuals(blank).square().sum().item() == pytest.approx(1.0, abs=1e-12)
