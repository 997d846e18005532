"""Laws of a rendered view, of every back end."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.helpers.compare_renders import LAW_TOLERANCE, assert_close, assert_same_picture, draw, home, value_and_gradients
from tests.helpers.gaussian_clouds import POSE, cloud, gray_blob, identity, joined, pinhole

from rtgs.config import Backend
from rtgs.maths.geometry import SE3, quat_from_rotation, rotation_from_axis_angle, rotation_from_quat
from rtgs.maths.sh import C0, coefficients
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import RenderSettings, render


@pytest.mark.parametrize("with_depth", [False, True])
def test_no_gaussian_and_all_culled_are_black(backend: Backend, with_depth: bool) -> None:
    camera, settings = pinhole(20, 18), RenderSettings(with_depth=with_depth)
    behind = replace(cloud(5), means=cloud(5).means - torch.tensor([0.0, 0.0, 50.0]))
    for model in (cloud(0), behind):
        view, gradients = value_and_gradients(backend, model, camera, POSE, settings)
        assert view.color.shape == (18, 20, 3) and view.alpha.shape == (18, 20)
        assert not view.color.any() and not view.alpha.any() and not view.visible.any()
        assert all(not g.any() for g in gradients.values())


def test_permutation_leaves_the_picture(backend: Backend) -> None:
    model = cloud(120)
    shuffled = torch.randperm(120, generator=torch.Generator().manual_seed(1))
    permuted = Gaussians(**{k: v[shuffled] for k, v in model.tensors().items()})
    a, b = draw(model, pinhole(37, 21), POSE, backend), draw(permuted, pinhole(37, 21), POSE, backend)
    # Sorted by depth the sums are the same; torch's own vectorised loops may round a row by where it stands.
    assert_same_picture(a, b, {"cpu": 0.0, "cuda": 1e-6, "reference": 1e-12}[backend])
    assert torch.equal(a.visible[shuffled], b.visible)


def test_moving_world_and_camera_together_leaves_the_picture(backend: Backend) -> None:
    model = cloud(120, 0).to(torch.float64)  # spherical harmonics live in the world, so only degree 0 moves along
    world = SE3(torch.tensor(rotation_from_axis_angle([0.7, -1.1, 0.4])), torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64))
    turned = np.stack([quat_from_rotation(world.rotation.numpy() @ rotation_from_quat(q)) for q in model.quats.numpy()])
    moved = replace(model, means=world.apply(model.means), quats=torch.tensor(turned))
    assert_same_picture(
        draw(model, pinhole(37, 21), POSE, backend),
        draw(moved, pinhole(37, 21), POSE @ world.inverse(), backend),
        LAW_TOLERANCE[backend],
    )


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_the_unit_of_length_is_free(backend: Backend, factor: float) -> None:
    model = cloud(120)
    a = draw(model, pinhole(37, 21), POSE, backend, near_plane=2.5, with_depth=True)
    b = draw(
        model.scaled(factor),
        pinhole(37, 21),
        POSE.with_baseline_scaled(factor),
        backend,
        near_plane=2.5 * factor,
        with_depth=True,
    )
    assert 0 < a.visible.sum() < 120  # the near plane cuts
    # `scaled` adds ln(factor) in the model's float32, whichever the back end.
    assert_same_picture(a, b, 5e-5)
    assert a.depth is not None and b.depth is not None
    assert_close(b.depth / factor, a.depth, 2e-4, "depth")


def test_length_and_sign_of_a_quaternion_mean_nothing(backend: Backend) -> None:
    model = cloud(120)
    lengths = torch.linspace(-3.0, 7.0, 120)[:, None]
    assert_same_picture(
        draw(model, pinhole(37, 21), POSE, backend),
        draw(replace(model, quats=model.quats * lengths), pinhole(37, 21), POSE, backend),
        5e-5,  # the product is rounded to the model's float32
    )


def test_no_opacity_is_black(backend: Backend) -> None:
    view = draw(replace(cloud(50), opacity_logits=torch.full((50,), -30.0)), pinhole(37, 21), POSE, backend)
    assert not view.color.any() and not view.alpha.any() and not view.visible.any()


@pytest.mark.parametrize("antialiased", [False, True])
def test_one_gaussian_known_answer(backend: Backend, antialiased: bool) -> None:
    # σ = 0.3 at depth 4 through f = 40 is 3 px; with the blur, 9.3 px². Anti-aliased: opacity × √(9·9 / (9.3·9.3)) = × 9/9.3.
    camera = Camera("PINHOLE", 33, 33, 40.0, 40.0, 16.5, 16.5)
    view = draw(gray_blob((0, 0, 4.0), 0.3, 2.0, 0.7), camera, identity(), backend, with_depth=True, antialiased=antialiased)
    y, x = torch.meshgrid(torch.arange(33) - 16.0, torch.arange(33) - 16.0, indexing="ij")
    opacity = 1 / (1 + math.exp(-2.0)) * (9 / 9.3 if antialiased else 1.0)
    expected = opacity * torch.exp(-(x * x + y * y) / (2 * 9.3))
    expected = torch.where(expected >= 1 / 255, expected, torch.zeros(()))
    assert_close(view.alpha, expected, 2e-6, "alpha")
    assert_close(view.color[..., 0], 0.7 * expected, 2e-6, "color")
    assert view.depth is not None
    assert_close(view.depth, 4.0 * expected, 1e-5, "depth")
    assert (view.alpha == 0).any()


def test_an_opaque_gaussian_lets_a_thousandth_through(backend: Backend) -> None:
    camera = Camera("PINHOLE", 17, 17, 40.0, 40.0, 8.5, 8.5)
    front, back = gray_blob((0, 0, 2.0), 5.0, 20.0, 0.6), gray_blob((0, 0, 4.0), 10.0, 20.0, 1.0)
    view = draw(joined(back, front), camera, identity(), backend)
    # The other would let 1e-6 of the light through, under 1e-4: the pixel is finished before it.
    assert view.color[8, 8, 0].item() == pytest.approx(0.999 * 0.6, abs=1e-6)
    assert view.alpha[8, 8].item() == pytest.approx(0.999, abs=1e-6)
    thin = replace(front, opacity_logits=torch.tensor([0.0]))
    view = draw(joined(back, thin), camera, identity(), backend)
    assert view.color[8, 8, 0].item() == pytest.approx(0.5 * 0.6 + 0.5 * 0.999 * 1.0, abs=1e-6)


def test_over_a_background(backend: Backend) -> None:
    model = cloud(80, size=0.03)
    view = draw(model, pinhole(37, 21), POSE, backend)
    background = torch.tensor([0.2, 0.5, 0.9], dtype=view.color.dtype)
    over = view.over(background)
    torch.testing.assert_close(over, view.color + (1 - view.alpha[..., None]) * background)
    empty = view.alpha == 0
    assert empty.any() and torch.equal(over[empty], background.expand(int(empty.sum()), 3))
    # The same as a wall far behind everything in that colour.
    wall = Gaussians(
        POSE.inverse().apply(torch.tensor([[0.0, 0.0, 100.0]], dtype=torch.float64)).float(),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        torch.full((1, 3), math.log(1e4)),
        torch.tensor([30.0]),
        torch.cat([((background.float() - 0.5) / C0).reshape(1, 1, 3), torch.zeros(1, 15, 3)], dim=1),
    )
    # The wall covers 0.999 of what is left (and nothing at all where that would leave less than 1e-4).
    walled = draw(joined(model, wall), pinhole(37, 21), POSE, backend).color
    open_ = view.alpha < 0.89
    assert_close(walled[open_], over[open_], 2e-3, "wall")


@pytest.mark.parametrize("with_depth", [False, True])
def test_channel_weights_are_the_weighted_sum_of_the_channels(backend: Backend, with_depth: bool) -> None:
    weights = (0.299, 0.587, 0.114)
    full = draw(cloud(80), pinhole(37, 21), POSE, backend, with_depth=with_depth)
    gray = draw(cloud(80), pinhole(37, 21), POSE, backend, with_depth=with_depth, channel_weights=weights)
    assert gray.color.shape == (21, 37, 1)
    assert_close(gray.color[..., 0], full.color @ torch.tensor(weights, dtype=full.color.dtype), 1e-6, "gray")
    assert_close(gray.alpha, full.alpha, 0.0, "alpha")


@pytest.mark.parametrize("pixel", [(3, 7), (15, 16), (31, 0)])
def test_pixel_centres_are_at_half_integers(backend: Backend, pixel: tuple[int, int]) -> None:
    camera = Camera("PINHOLE", 33, 20, 41.0, 43.0, 15.2, 11.9)
    i, j = pixel
    z = 2.5
    point = ((i + 0.5 - camera.cx) / camera.fl_x * z, (j + 0.5 - camera.cy) / camera.fl_y * z, z)
    image = draw(gray_blob(point, 1e-6, 3.0), camera, identity(), backend).alpha
    assert image.argmax().item() == j * 33 + i
    # Only the 0.3 px² blur is left: the next pixel centre is exp(−1 / 0.6) of the peak, on either side.
    left, right = (image[j, k].item() / image[j, i].item() for k in (i - 1, i + 1))
    assert left == pytest.approx(math.exp(-1 / 0.6), rel=2e-4) and right == pytest.approx(math.exp(-1 / 0.6), rel=2e-4)


def test_depth_of_a_plane(backend: Backend) -> None:
    g = torch.Generator().manual_seed(0)
    plane = replace(cloud(200, 0, 1), log_scales=torch.full((200, 3), math.log(0.2)), opacity_logits=torch.full((200,), 1.0))
    xy = torch.rand(200, 2, generator=g) * 4 - 2
    plane = replace(plane, means=torch.cat([xy, torch.full((200, 1), 3.25)], dim=1))
    view = draw(plane, pinhole(37, 21), identity(), backend, with_depth=True)
    assert view.depth is not None
    covered = view.alpha > 0.05
    assert covered.float().mean() > 0.9
    torch.testing.assert_close((view.depth / view.alpha)[covered], torch.full_like(view.alpha[covered], 3.25), rtol=1e-5, atol=0)


def test_pixel_offsets_move_the_picture(backend: Backend) -> None:
    model, camera = cloud(60, 0).to(**home(backend)), pinhole(40, 30)
    offset = torch.tensor([2.0, 3.0], **home(backend)).expand(60, 2)
    settings = RenderSettings(backend=backend)
    moved = render(model, camera, POSE, settings=settings, pixel_offsets=offset).color.cpu()
    still = render(model, camera, POSE, settings=settings).color.cpu()
    assert still.max() > 0.5
    assert_close(moved[3:, 2:], still[:-3, :-2], 5e-5, "moved")  # float32 centres round differently 3 px on


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_fewer_bands_are_the_model_without_them(backend: Backend, degree: int) -> None:
    model = cloud(60, 3)
    cut = replace(model, sh=model.sh.clone())
    cut.sh[:, coefficients(degree) :] = 0.0
    a = draw(model, pinhole(37, 21), POSE, backend, sh_degree=degree)
    assert_same_picture(a, draw(cut, pinhole(37, 21), POSE, backend), 1e-6)
    assert (a.color - draw(model, pinhole(37, 21), POSE, backend).color).abs().max() > 0.01
