"""The compiled back ends against the reference."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.helpers.compare_renders import assert_backends_agree, draw, value_and_gradients
from tests.helpers.gaussian_clouds import INVISIBLE, POSE, VISIBLE, cloud, degenerate, identity, joined, pinhole

from rtgs.config import Backend
from rtgs.renderer import RenderSettings


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_compiled_equals_reference(compiled: Backend, degree: int, channels: int, antialiased: bool) -> None:
    # 37 × 21: both axes end inside a tile, and there is more than one tile along each.
    settings = RenderSettings(with_depth=channels == 3 or degree % 2 == 0, antialiased=antialiased)
    assert_backends_agree(cloud(150, degree, channels, seed=degree), pinhole(37, 21), settings, backend=compiled)


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (5, 40), (33, 15)])
def test_compiled_equals_reference_at_any_image_size(compiled: Backend, size: tuple[int, int]) -> None:
    assert_backends_agree(cloud(60, 1, 3), pinhole(*size, focal=30.0), RenderSettings(with_depth=True), backend=compiled)


def test_compiled_equals_reference_behind_an_opaque_crowd(compiled: Backend) -> None:
    # Every pixel is spent after a few of 300 large Gaussians: the early end of a tile, forward and backward.
    crowd = cloud(300, 0, 3, size=0.5)
    crowd = replace(crowd, opacity_logits=crowd.opacity_logits + 3.0)
    assert draw(crowd, pinhole(40, 24), POSE, compiled).alpha.min() > 0.99
    # 1 − α is a few 1e-3 all over, so the remainder's rounding is divided by that everywhere.
    assert_backends_agree(crowd, pinhole(40, 24), RenderSettings(), loosen=10.0, backend=compiled)


@pytest.mark.thorough
@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("kind", INVISIBLE + VISIBLE)
def test_compiled_equals_reference_on_degenerate_gaussians(
    compiled: Backend, kind: str, antialiased: bool, request: pytest.FixtureRequest
) -> None:
    if "on a GPU" in request.node.name and kind == "needle" and antialiased:
        pytest.skip("gsplat takes det Σ from a float32 difference, which is noise for a needle")
    camera, settings = pinhole(37, 21), RenderSettings(near_plane=0.5, with_depth=True, antialiased=antialiased)
    alone = degenerate(kind)
    if not antialiased:  # anti-aliasing rightly fades what is thinner than a pixel
        assert draw(alone, camera, identity(), compiled, near_plane=0.5).visible.item() == (kind in VISIBLE)
    # A conic cancels as (length / width)² of what is drawn: 4e3 for the needle, 1e6 for the huge one.
    loosen = {"needle": 20.0, "flat": 3.0, "huge": 3.0}.get(kind, 1.0)
    assert_backends_agree(alone, camera, settings, identity(), loosen, backend=compiled)
    shifted = replace(cloud(40, 2, 3), means=cloud(40, 2, 3).means + torch.tensor([0.0, 0.0, 3.0]))
    assert_backends_agree(joined(shifted, alone, shifted), camera, settings, identity(), loosen, backend=compiled)


@pytest.mark.parametrize("kind", ["absurdly huge", "absurd needle"])
def test_beyond_float32_nothing_becomes_nan(kind: str) -> None:
    # Their conics have no determinant left in float32: the compiled code may leave them out, but must not spoil the rest.
    shifted = replace(cloud(40, 2, 3), means=cloud(40, 2, 3).means + torch.tensor([0.0, 0.0, 3.0]))
    view, gradients = value_and_gradients(
        "cpu", joined(shifted, degenerate(kind)), pinhole(37, 21), identity(), RenderSettings(with_depth=True)
    )
    for name, value in {"color": view.color, "alpha": view.alpha, **gradients}.items():
        assert torch.isfinite(value).all(), name


@pytest.mark.parametrize("kind", VISIBLE)
def test_equal_depth_composites_in_model_order(compiled: Backend, kind: str) -> None:
    red, blue = degenerate(kind), degenerate(kind)
    red.sh[:, :, 0] += 1.0
    blue.sh[:, :, 2] += 1.0
    camera = pinhole(37, 21)
    settings = RenderSettings(near_plane=0.5)
    loosen = {"needle": 20.0}.get(kind, 1.0)
    assert_backends_agree(joined(red, blue), camera, settings, identity(), loosen, backend=compiled)
    first = draw(joined(red, blue), camera, identity(), compiled, near_plane=0.5).color
    second = draw(joined(blue, red), camera, identity(), compiled, near_plane=0.5).color
    assert (first[..., 0] > second[..., 0]).any() and not (first[..., 0] < second[..., 0] - 1e-6).any()
