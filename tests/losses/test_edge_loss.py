"""Every implementation of the edge loss keeps the same laws, and the compiled one equals the readable one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from scipy import ndimage
from tests.helpers.textures import holes, textured
from torch import Tensor

from rtgs.config import PAPER_EPSILON
from rtgs.images.filters import SOBEL
from rtgs.losses.edge_loss import EdgeLoss, EdgeTarget
from rtgs.losses.ngf import NgfPyramid, normalized_gradient
from rtgs.losses.ngf_fused import FusedNgf


@dataclass(frozen=True)
class Implementation:
    """How a target is prepared, what pictures it takes, and how exact it is."""

    name: str
    of: Callable[[NgfPyramid], EdgeTarget]
    dtype: torch.dtype
    tolerance: float  # of a loss; float32: gradients of order 0.1 carry 1e-6

    def target(self, image: Tensor, mask: Tensor | None = None, settings: EdgeLoss | None = None) -> EdgeTarget:
        return self.of(NgfPyramid.of(image, mask, settings or EdgeLoss()))

    def picture(self, image: Tensor) -> Tensor:
        return image.to(self.dtype)


IMPLEMENTATIONS = [
    Implementation("readable", lambda pyramid: pyramid, torch.float64, 1e-10),
    Implementation("compiled", FusedNgf.of, torch.float32, 1e-5),
]
both = pytest.mark.parametrize("how", IMPLEMENTATIONS, ids=lambda how: how.name)
per_edge_or_not = pytest.mark.parametrize("per_edge", [False, True])


def target_of(
    epsilon: float | tuple[float, ...], masked: bool, per_edge: bool = False, across: tuple[float, float] = SOBEL
) -> NgfPyramid:
    """A textured target, NaN where it is masked."""
    image = torch.where(holes(), textured(seed=1), torch.tensor(torch.nan, dtype=torch.float64)) if masked else textured(seed=1)
    settings = EdgeLoss(epsilon=epsilon, render_epsilon=0.2, per_edge=per_edge, across=across)
    return NgfPyramid.of(image, holes() if masked else None, settings)


@both
@per_edge_or_not
@pytest.mark.thorough
@pytest.mark.parametrize("level", [0.0, 0.37, 1.0])
def test_a_featureless_render_scores_exactly_one(how: Implementation, level: float, per_edge: bool) -> None:
    target = how.target(textured(40, 52), settings=EdgeLoss(per_edge=per_edge))
    blank = how.picture(torch.full((40, 52), level))
    assert target.loss(blank) == 1.0
    result = target.products(blank, how.picture(textured(40, 52))[None])
    assert result.loss == 1.0 and result.slope[0] == 0.0 and np.isfinite(result.curvature).all()


@both
@pytest.mark.parametrize("change", [lambda x: x, lambda x: 1.0 - x, lambda x: 0.3 * x + 0.5])
def test_the_image_itself_costs_nothing_whatever_its_contrast(how: Implementation, change: Callable[[Tensor], Tensor]) -> None:
    image = textured(seed=2)
    # The paper's ε is a thousandth of these gradients; float32 differences of them turn by 1e-5.
    assert how.target(image).loss(how.picture(change(image))) < 1e-5
    assert how.target(image).loss(how.picture(textured(seed=3))) > 0.3


@both
@per_edge_or_not
def test_levels_without_a_valid_pixel_cost_their_weight(how: Implementation, per_edge: bool) -> None:
    nothing, image = torch.zeros(45, 58, dtype=torch.bool), textured(seed=2)
    target = how.target(textured(seed=1), nothing, EdgeLoss(epsilon=0.1, per_edge=per_edge))
    assert target.loss(how.picture(image)) == 1.0
    assert target.products(how.picture(image), how.picture(image)[None]).slope[0] == 0.0


@both
@per_edge_or_not
def test_masked_pixels_are_not_looked_at(how: Implementation, per_edge: bool) -> None:
    image, render, settings = textured(seed=1), textured(seed=2), EdgeLoss(epsilon=0.1, per_edge=per_edge)
    target, spoiled = (how.target(i, holes(), settings) for i in (image, torch.where(holes(), image, torch.nan)))
    changed = torch.where(holes(), render, 1.0 - 3.0 * render.flip(0))
    expected = target.loss(how.picture(render))
    assert spoiled.loss(how.picture(render)) == expected == target.loss(how.picture(changed))
    assert expected != how.target(image, None, settings).loss(how.picture(render))


@both
@per_edge_or_not
@pytest.mark.parametrize("masked", [False, True])
def test_slopes_are_the_losses_change(how: Implementation, per_edge: bool, masked: bool) -> None:
    target = how.of(target_of((0.1, 0.2, 0.4), masked, per_edge))
    render, tangents = textured(seed=2), torch.stack([textured(seed=s) - 0.5 for s in (3, 4, 5)])
    found = target.products(how.picture(render), how.picture(tangents))
    assert found.loss == pytest.approx(target.loss(how.picture(render)), abs=1e-7)
    assert found.slope.shape == (3,) and found.curvature.shape == (3, 3) and np.abs(found.slope).max() > 0.01
    h = 1e-5 if how.dtype == torch.float64 else 1e-2
    ends = [[target.loss(how.picture(render + sign * h * t)) for sign in (1, -1)] for t in tangents]
    # float32: a loss is known to 1e-7, so its difference over 2e-2 to 1e-5; the curve bends by as much.
    np.testing.assert_allclose(found.slope, [(a - b) / (2 * h) for a, b in ends], rtol=1e-2, atol=1e-4)


@both
def test_directions_do_not_see_each_other(how: Implementation) -> None:
    target, image = how.of(target_of(0.05, True)), how.picture(textured(seed=2))
    ways = how.picture(torch.stack([textured(seed=s) for s in range(3, 11)]))
    together = target.products(image, ways)
    for k in range(len(ways)):
        alone = target.products(image, ways[k : k + 1])
        assert alone.slope[0] == pytest.approx(together.slope[k], rel=1e-5, abs=1e-7)
        assert alone.curvature[0, 0] == pytest.approx(together.curvature[k, k], rel=1e-5)
    np.testing.assert_allclose(together.curvature, together.curvature.T, rtol=1e-12)


@both
@pytest.mark.parametrize("masked", [False, True])
def test_per_edge_is_the_mean_agreement_over_the_renders_own_strength(how: Implementation, masked: bool) -> None:
    image, render, valid = textured(seed=1), textured(seed=2), holes() if masked else torch.ones(45, 58, dtype=torch.bool)
    n, m = (normalized_gradient(picture, 0.2) for picture in (render, image))
    inner = ndimage.binary_erosion(valid, np.ones((3, 3)), border_value=1)[1:-1, 1:-1]
    agreement, strength = ((n * m).sum(0) ** 2)[inner].mean(), n.square().sum(0)[inner].mean().sqrt()
    target = how.target(image, valid, EdgeLoss((1.0,), epsilon=0.2, per_edge=True))
    assert 0.1 < strength < 0.95
    assert target.loss(how.picture(render)) == pytest.approx(1 - (agreement / strength).item(), abs=how.tolerance)


@both
def test_per_edge_more_edge_is_no_merit_in_itself(how: Implementation) -> None:
    """A render whose contrast grows falls in Eq. 6 for that alone; per edge it falls a good deal less."""
    image, render = textured(seed=1), textured(seed=2)
    falls = []
    for per_edge in (False, True):
        target = how.target(image, settings=EdgeLoss(epsilon=0.2, per_edge=per_edge))
        weak, strong = (1 - target.loss(how.picture(render * contrast)) for contrast in (1.0, 1.1))
        falls.append(strong / weak - 1)
    assert 0 < falls[1] < 0.7 * falls[0]


@per_edge_or_not
@pytest.mark.thorough
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize(
    "epsilon, across", [(PAPER_EPSILON, SOBEL), (0.2, SOBEL), ((0.01, 0.1, 0.4), SOBEL), (0.2, (0.75, 2.5)), (0.2, (0.0, 4.0))]
)
def test_the_compiled_loss_equals_the_readable_one(
    epsilon: float | tuple[float, ...], across: tuple[float, float], masked: bool, per_edge: bool
) -> None:
    readable = target_of(epsilon, masked, per_edge, across)
    compiled, render = FusedNgf.of(readable), textured(seed=2)
    tangents = torch.stack([textured(seed=s) - 0.5 for s in (3, 4, 5)])
    found, expected = compiled.products(render.float(), tangents.float()), readable.products(render, tangents)
    assert found.loss == pytest.approx(expected.loss, abs=1e-5)
    assert np.abs(expected.slope).max() > 0.01
    np.testing.assert_allclose(found.slope, expected.slope, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(found.curvature, expected.curvature, rtol=1e-3, atol=1e-4)
    np.testing.assert_array_equal(found.curvature, found.curvature.T)
    alone = compiled.products(render.float(), tangents.float(), curvature=False)
    assert (alone.loss, alone.slope.tolist()) == (found.loss, found.slope.tolist()) and not alone.curvature.any()
    np.testing.assert_array_equal(readable.products(render, tangents, curvature=False).slope, expected.slope)
    if not per_edge:  # the slope is what the residuals say, too
        jacobian = torch.stack([torch.func.jvp(readable.residuals, (render,), (t,))[1] for t in tangents])
        np.testing.assert_allclose(expected.slope, 2 * jacobian @ readable.residuals(render), rtol=1e-6, atol=1e-9)


def test_epsilon_is_one_number_or_one_a_level() -> None:
    assert EdgeLoss(epsilon=0.1).epsilons == EdgeLoss(epsilon=0.1).render_epsilons == (0.1, 0.1, 0.1)
    each = EdgeLoss((1.0, 1.0), epsilon=(0.1, 0.2), render_epsilon=0.3)
    assert each.epsilons == (0.1, 0.2) and each.render_epsilons == (0.3, 0.3)


def test_softening_is_linear_and_without_blur_does_nothing() -> None:
    pictures, soft = torch.stack([textured(seed=s) for s in (1, 2)]), EdgeLoss(blur_px=1.4)
    assert EdgeLoss().softened(pictures) is pictures
    total = soft.softened(pictures.sum(0, keepdim=True))
    torch.testing.assert_close(soft.softened(pictures).sum(0, keepdim=True), total)
    assert soft.softened(pictures).std() < 0.9 * pictures.std()
