"""Colours as a linear map: W and its transpose, against each other and against `render`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numba
import pytest
import torch
from tests.helpers.compare_renders import assert_close
from tests.helpers.gaussian_clouds import POSE, cloud, pinhole
from tests.helpers.gradients import gradient_of

from rtgs.base.errors import RtgsError
from rtgs.config import Backend
from rtgs.maths.geometry import SE3
from rtgs.maths.sh import C0
from rtgs.renderer import LinearRender, LinearViews, RenderSettings, render

BACKENDS = ["cpu", "reference"]


def settings(backend: Backend, **more: Any) -> RenderSettings:
    return RenderSettings(backend=backend, **more)


@pytest.mark.thorough
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("backend", BACKENDS)
def test_adjoint(backend: Backend, antialiased: bool, channels: int) -> None:
    """⟨W·c + (1 − α)·b, y⟩ = ⟨c, Wᵀ·y⟩ + ⟨b, (1 − α)ᵀ·y⟩."""
    model = cloud(300, size=0.06)
    dtype = torch.float32 if backend == "cpu" else torch.float64
    view = LinearRender(
        model.to(dtype), pinhole(150, 90), POSE, channels=channels, settings=settings(backend, antialiased=antialiased)
    )
    g = torch.Generator().manual_seed(1)
    colors, background = torch.randn(300, channels, generator=g), torch.randn(channels, generator=g)
    y = torch.randn(90, 150, channels, generator=g)
    colors, background, y = colors.to(dtype), background.to(dtype), y.to(dtype)
    image = view.image(colors, background)
    back, back_background = view.adjoint(y)
    forwards = (image.double() * y.double()).sum()
    backwards = (back.double() * colors.double()).sum() + (back_background.double() * background.double()).sum()
    assert abs(forwards - backwards) <= 1e-6 * image.double().norm() * y.double().norm()
    assert back.abs().max() > 0.1 and back_background.abs().max() > 0.1


@pytest.mark.parametrize("backend", BACKENDS)
def test_image_is_what_render_draws(backend: Backend) -> None:
    dtype = torch.float32 if backend == "cpu" else torch.float64
    model = cloud(200, 0, 3).to(dtype)
    view = render(model, pinhole(45, 33), POSE, settings=settings(backend))
    linear = LinearRender(model, pinhole(45, 33), POSE, channels=3, settings=settings(backend))
    colors = (0.5 + C0 * model.sh[:, 0]).clamp_min(0.0)
    assert_close(linear.alpha, view.alpha, 1e-6, "alpha")
    assert_close(linear.image(colors), view.color, 1e-6, "image")
    background = torch.tensor([0.1, 0.7, 0.4], dtype=dtype)
    assert_close(linear.image(colors, background), view.over(background), 1e-6, "over a background")


@pytest.mark.parametrize("backend", BACKENDS)
def test_linear_and_free_of_what_was_drawn_before(backend: Backend) -> None:
    model = cloud(100)
    view = LinearRender(model, pinhole(37, 21), POSE, channels=2, settings=settings(backend))
    g = torch.Generator().manual_seed(2)
    a, b = torch.randn(100, 2, generator=g), torch.randn(100, 2, generator=g)
    sums = 2.0 * view.image(a) - 3.0 * view.image(b)  # negative colours too: nothing is clamped
    assert_close(view.image(2.0 * a - 3.0 * b), sums, 1e-5, "sum")
    y = torch.randn(21, 37, 2, generator=g)
    first = view.adjoint(y)[0]
    view.image(b)
    assert torch.equal(view.adjoint(y)[0], first)
    # Each channel is on its own.
    assert_close(view.image(a)[..., 1], view.image(a * torch.tensor([7.0, 1.0]))[..., 1], 1e-6, "channel")


def test_adjoint_is_the_colours_gradient() -> None:
    model, camera = cloud(150, 0, 3), pinhole(37, 21)
    sh = model.sh.clone().requires_grad_()
    y = torch.randn(21, 37, 3, generator=torch.Generator().manual_seed(3))
    (render(replace(model, sh=sh), camera, POSE).color * y).sum().backward()
    back, _ = LinearRender(model, camera, POSE, channels=3).adjoint(y)
    shown = (0.5 + C0 * model.sh[:, 0]) > 0
    assert_close(gradient_of(sh)[:, 0], C0 * back * shown, 1e-5, "gradient")


def test_views_keep_what_fits_and_give_the_same_either_way() -> None:
    model, camera = cloud(200, size=0.05), pinhole(70, 50)
    poses = [SE3(POSE.rotation, POSE.translation + torch.tensor([0.1 * k, 0.0, 0.0])) for k in range(4)]
    one = LinearRender(model, camera, poses[0])
    everything, some = LinearViews(model, camera, poses), LinearViews(model, camera, poses, budget_bytes=int(2.5 * one.nbytes))
    assert len(everything) == 4 and one.nbytes > 0
    colors = torch.randn(200, 1, generator=torch.Generator().manual_seed(4))
    for _ in range(2):
        for a, b in zip(everything, some, strict=True):
            assert torch.equal(a.image(colors), b.image(colors))
    kept = [some[k] is some[k] for k in range(4)]
    assert kept == [True, True, False, False] and everything[3] is everything[-1]
    with pytest.raises(IndexError):
        some[4]


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_gaussian(backend: Backend) -> None:
    view = LinearRender(cloud(0), pinhole(20, 18), POSE, settings=settings(backend))
    assert not view.image(torch.zeros(0, 1)).any() and not view.alpha.any()
    back, background = view.adjoint(torch.ones(18, 20, 1))
    assert back.shape == (0, 1) and background.item() == 360.0


def test_what_cannot_be_done_is_refused() -> None:
    with pytest.raises(RtgsError, match="undistort"):
        LinearRender(cloud(3), replace(pinhole(20, 20), model="OPENCV"), POSE)
    with pytest.raises(RtgsError, match=r"9 channels.*8"):
        LinearRender(cloud(3), pinhole(20, 20), POSE, channels=9)
    with pytest.raises(RtgsError, match=r"one row in 4 of a picture of 2"):
        LinearRender(cloud(3), pinhole(20, 2), POSE, every=4)


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("every", [2, 3, 4])
@pytest.mark.parametrize("backend", BACKENDS)
def test_some_rows_are_those_of_the_whole_picture(backend: Backend, every: int, antialiased: bool) -> None:
    """Thin Gaussians, where it shows whether they are blurred as in whole pictures; the transpose is that of leaving rows out."""
    dtype = torch.float32 if backend == "cpu" else torch.float64
    model, camera = cloud(250, size=0.01).to(dtype), pinhole(75, 46)
    chosen, rows = settings(backend, antialiased=antialiased), slice(every // 2, None, every)
    whole, some = (LinearRender(model, camera, POSE, channels=2, settings=chosen, every=k) for k in (1, every))
    g = torch.Generator().manual_seed(2)
    colors, background = torch.randn(250, 2, generator=g).to(dtype), torch.randn(2, generator=g).to(dtype)
    picture = whole.image(colors, background)[rows]
    assert some.shape == tuple(picture.shape[:2]) and picture.abs().max() > 0.5
    assert_close(some.image(colors, background), picture, 1e-4, "image")
    assert_close(some.alpha, whole.alpha[rows], 1e-4, "alpha")
    y = torch.randn(picture.shape, generator=g).to(dtype)
    padded = torch.zeros(46, 75, 2, dtype=dtype)
    padded[rows] = y
    for a, b in zip(some.adjoint(y), whole.adjoint(padded), strict=True):
        assert_close(a, b, 1e-4, "adjoint")


def kept(view: LinearRender) -> LinearRender:
    before = view.nbytes
    view.keep_weights(1 << 30)
    assert view.nbytes != before
    return view


@pytest.mark.parametrize(("width", "height"), [(150, 90), (16, 16), (37, 5), (700, 450)])
@pytest.mark.parametrize("channels", [1, 2, 5])
def test_kept_weights_are_the_same_map_but_for_rounding(channels: int, width: int, height: int) -> None:
    """Whole and partial patches, tiles of all sizes; the transpose is exactly that of the rounded weights."""
    model, camera = cloud(400, size=0.05), pinhole(width, height)
    plain, view = LinearRender(model, camera, POSE, channels=channels), kept(LinearRender(model, camera, POSE, channels=channels))
    g = torch.Generator().manual_seed(7)
    colors, background = torch.randn(400, channels, generator=g), torch.randn(channels, generator=g)
    y = torch.randn(height, width, channels, generator=g)
    image, (back, back_background) = view.image(colors, background), view.adjoint(y)
    assert (image - plain.image(colors, background)).abs().max() < 40 * 3 / 65535  # so many Gaussians a pixel, of colours up to 3
    expected, _ = plain.adjoint(y)
    assert_close(back, expected, 1e-4 * float(expected.abs().max()), "adjoint")
    through = view.image(torch.zeros(400, 1), torch.ones(1))[..., 0]  # the background's weights, rounded too
    assert (through - (1.0 - plain.alpha)).abs().max() < 0.51 / 65535
    assert_close(back_background, torch.einsum("hw,hwc->c", through.double(), y.double()), 1e-4, "background")
    forwards = (image.double() * y.double()).sum()
    backwards = (back.double() * colors.double()).sum() + (back_background.double() * background.double()).sum()
    assert abs(forwards - backwards) <= 1e-6 * image.double().norm() * y.double().norm()
    assert torch.equal(view.alpha, plain.alpha)
    assert set(view.visible) <= set(plain.visible) and not back[[i for i in range(400) if i not in set(view.visible)]].any()
    # Channels in one piece each are taken as they are, others are copied.
    assert torch.equal(view.adjoint(y.permute(2, 0, 1).contiguous().permute(1, 2, 0))[0], back)


def test_kept_weights_do_not_depend_on_threads() -> None:
    threads, found = numba.get_num_threads(), []
    g = torch.Generator().manual_seed(1)
    colors, y = torch.randn(300, 2, generator=g), torch.randn(120, 160, 2, generator=g)
    try:
        for n in (1, threads):
            numba.set_num_threads(n)
            view = kept(LinearRender(cloud(300, size=0.1), pinhole(160, 120), POSE, channels=2))
            found.append((view.image(colors), view.adjoint(y)[0]))
    finally:
        numba.set_num_threads(threads)
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))


def test_weights_are_kept_with_what_the_lists_leave() -> None:
    model, camera = cloud(200, size=0.05), pinhole(70, 50)
    poses = [SE3(POSE.rotation, POSE.translation + torch.tensor([0.02 * k, 0.0, 0.0])) for k in range(4)]
    lists, weights = LinearRender(model, camera, poses[0]), kept(LinearRender(model, camera, poses[0]))
    assert weights.nbytes > lists.nbytes
    refused = LinearRender(model, camera, poses[0])
    refused.keep_weights(weights.nbytes // 2)
    assert refused.nbytes == lists.nbytes
    budget = int(2.5 * weights.nbytes + 2.5 * lists.nbytes)
    views = LinearViews(model, camera, poses, budget_bytes=budget, keep_weights=True)
    sizes = [views[k].nbytes for k in range(4)]
    assert all(views[k] is views[k] for k in range(4)) and sum(sizes) <= budget
    assert min(sizes[:2]) > max(sizes[2:])
    plain = [LinearViews(model, camera, poses, budget_bytes=budget)[k].nbytes for k in range(4)]
    assert sizes[2:] == plain[2:]


def test_no_weights_to_keep() -> None:
    """The background is all there is."""
    view = kept(LinearRender(cloud(0), pinhole(20, 18), POSE))
    torch.testing.assert_close(view.image(torch.zeros(0, 1), torch.tensor([0.7])), torch.full((18, 20, 1), 0.7))
    colors, background = view.adjoint(torch.ones(18, 20, 1))
    assert colors.shape == (0, 1) and float(background) == pytest.approx(360.0)


@pytest.mark.parametrize("keep", [False, True])
def test_colours_of_another_model_are_refused(keep: bool) -> None:
    view = LinearRender(cloud(30), pinhole(20, 18), POSE)
    with pytest.raises(ValueError, match="colours of 3 Gaussians, not 30"):
        (kept(view) if keep else view).image(torch.zeros(3, 1))


def test_cpu_takes_the_place_of_cuda_which_has_no_linear_map() -> None:
    colors = torch.rand(30, 1, generator=torch.Generator().manual_seed(8))
    asked, done = (LinearRender(cloud(30), pinhole(20, 18), POSE, settings=settings(backend)) for backend in ("cuda", "cpu"))
    assert torch.equal(asked.image(colors), done.image(colors)) and done.alpha.max() > 0.5
