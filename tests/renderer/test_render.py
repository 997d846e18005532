"""The renderer: reference against finite differences and gsplat, compiled back ends against reference, and laws of all."""

from __future__ import annotations

import importlib
import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3, quat_from_rotation, rotation_from_axis_angle, rotation_from_quat
from rtgs.maths.sh import C0, coefficients
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import Render, RenderSettings, reference, render

# test_cuda.py gives "cuda" to every test here that takes a back end.
BACKENDS = ["cpu", "reference"]
COMPILED = ["cpu"]  # those held against the reference
NAMES = ("means", "quats", "log_scales", "opacity_logits", "sh")
POSE = SE3(
    torch.tensor(rotation_from_axis_angle([0.1, -0.2, 0.15])).float().double(), torch.tensor([0.1, -0.05, 3.0]).float().double()
)


def pinhole(width: int, height: int, focal: float | None = None) -> Camera:
    """Unequal focal lengths and an off-centre principal point, so that no axis can stand for another."""
    f = focal or 1.1 * width
    return Camera("PINHOLE", width, height, f, 1.07 * f, 0.48 * width, 0.53 * height)


def cloud(n: int, degree: int = 3, channels: int = 3, seed: int = 0, size: float = 0.12) -> Gaussians:
    """A random model about the origin; every number fits float32, so that both back ends are given the same one."""
    g = torch.Generator().manual_seed(seed)
    sh = 0.15 * torch.randn(n, coefficients(degree), channels, generator=g)
    sh[:, 0] = 3.0 * torch.rand(n, channels, generator=g) - 1.0  # a few colours are clamped at black
    return Gaussians(
        torch.rand(n, 3, generator=g) * 1.8 - 0.9,
        torch.randn(n, 4, generator=g),
        math.log(size) + 0.6 * torch.randn(n, 3, generator=g),
        1.5 * torch.randn(n, generator=g),
        sh,
    )


def gray_blob(mean: tuple[float, float, float], sigma: float, opacity_logit: float, color: float = 0.5) -> Gaussians:
    """One isotropic Gaussian of one channel."""
    return Gaussians(
        torch.tensor([mean]),
        torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        torch.full((1, 3), math.log(sigma)),
        torch.tensor([opacity_logit]),
        torch.full((1, 1, 1), (color - 0.5) / C0),
    )


def joined(*models: Gaussians) -> Gaussians:
    return Gaussians(**{k: torch.cat([m.tensors()[k] for m in models]) for k in NAMES})


def identity() -> SE3:
    return SE3(torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))


def home(backend: str) -> dict[str, Any]:
    """Where and in which precision a back end computes."""
    gpu = backend == "cuda" and torch.cuda.is_available()  # without a GPU test_cuda.py puts gsplat's kernels on the CPU
    return {"device": "cuda" if gpu else "cpu", "dtype": torch.float64 if backend == "reference" else torch.float32}


def on_cpu(view: Render) -> Render:
    depth = None if view.depth is None else view.depth.cpu()
    return Render(view.color.cpu(), view.alpha.cpu(), depth, view.visible.cpu())


def draw(gaussians: Gaussians, camera: Camera, pose: SE3, backend: str, **settings: object) -> Render:
    """In the back end's own precision."""
    with torch.no_grad():
        return on_cpu(render(gaussians.to(**home(backend)), camera, pose, settings=RenderSettings(backend=backend, **settings)))


# --- the reference against finite differences ------------------------------------------------------


@pytest.mark.parametrize(("degree", "channels"), [(3, 1), (1, 3)])
@pytest.mark.parametrize("antialiased", [False, True])
def test_reference_gradient_equals_finite_differences(degree: int, channels: int, antialiased: bool) -> None:
    # The 1/255 cut-off and the end of a spent pixel are switched off (alpha_min = transmittance_min = 0). Three kinks remain and
    # the scene keeps away from them: α = 0.999 (opacities below 0.9), colour = 0 (a bright base colour), and the edge of the held
    # slopes: the last Gaussian lies well beyond it, the others well within, so that both sides are differentiated.
    camera = pinhole(6, 5)
    g = torch.Generator().manual_seed(degree)
    n = 3
    in_camera = torch.rand(n, 3, generator=g, dtype=torch.float64) * 1.2 - 0.6
    in_camera[:, 2] += 3.0
    in_camera[-1, 0] = 3.0 * 1.3 * 0.5 * 6 / camera.fl_x * 1.2
    means = POSE.inverse().apply(in_camera)
    log_scales = math.log(0.35) + 0.3 * torch.randn(n, 3, generator=g, dtype=torch.float64)
    log_scales[-1] += 1.2
    sh = 0.1 * torch.randn(n, coefficients(degree), channels, generator=g, dtype=torch.float64)
    sh[:, 0] += 1.0
    inputs = (
        means,
        torch.randn(n, 4, generator=g, dtype=torch.float64),
        log_scales,
        torch.randn(n, generator=g, dtype=torch.float64).clamp(-2, 2),
        sh,
        0.1 * torch.randn(n, 2, generator=g, dtype=torch.float64),
        POSE.rotation.clone(),
        POSE.translation.clone(),
    )

    def picture(
        means: Tensor, quats: Tensor, log_scales: Tensor, logits: Tensor, sh: Tensor, offsets: Tensor, rotation: Tensor, t: Tensor
    ) -> Tensor:
        pose = SE3(rotation, t)
        colors = reference.colors_from_sh(means, sh, -(rotation.T @ t))
        image, alpha, visible = reference.rasterize(
            means,
            quats,
            log_scales,
            logits,
            colors,
            camera,
            pose,
            near_plane=0.01,
            antialiased=antialiased,
            pixel_offsets=offsets,
            alpha_min=0.0,
            transmittance_min=0.0,
        )
        assert visible.all()
        return torch.cat([image, alpha[..., None]], dim=-1)

    leaves = [x.requires_grad_() for x in inputs]
    picture(*leaves).square().sum().backward()
    for leaf in leaves:  # a function that ignored an input would pass the check below
        assert leaf.grad is not None and leaf.grad.abs().max() > 1e-6
        leaf.grad = None
    assert torch.autograd.gradcheck(picture, leaves, eps=1e-6, atol=1e-6, rtol=1e-5)


def test_render_gradient_equals_finite_differences() -> None:
    # Through the one entrance: the view direction of the colours and the depth channel are wired there. Two Gaussians wide and faint
    # enough that no pixel of the picture is near a cut-off.
    camera = pinhole(5, 4)
    model = cloud(2, 3, 1, seed=3, size=1.5).to(torch.float64)
    model.sh[:, 0] = 1.0
    model = replace(model, opacity_logits=torch.tensor([-0.5, 0.3], dtype=torch.float64))

    def picture(means: Tensor, sh: Tensor, rotation: Tensor, translation: Tensor) -> Tensor:
        settings = RenderSettings(backend="reference", with_depth=True)
        view = render(replace(model, means=means, sh=sh), camera, SE3(rotation, translation), settings=settings)
        assert view.alpha.min() > 0.05 and view.depth is not None
        return torch.cat([view.color, view.alpha[..., None], view.depth[..., None]], dim=-1)

    leaves = [x.clone().requires_grad_() for x in (model.means, model.sh, POSE.rotation, POSE.translation)]
    assert torch.autograd.gradcheck(picture, leaves, eps=1e-6, atol=1e-6, rtol=1e-5)


# --- the compiled back ends against the reference ---------------------------------------------------


def value_and_gradients(
    backend: str, gaussians: Gaussians, camera: Camera, pose: SE3, settings: RenderSettings, weight: Tensor | None = None
) -> tuple[Render, dict[str, Tensor]]:
    """The render and the gradient of a fixed random linear function of all its images, in float64; `weight` `[H, W]` scales it."""
    here = home(backend)
    model = Gaussians(**{k: v.detach().to(**here).clone().requires_grad_() for k, v in gaussians.tensors().items()})
    leaves = dict(model.tensors())
    leaves["pixel_offsets"] = torch.zeros(len(gaussians), 2, **here, requires_grad=True)
    leaves["rotation"] = pose.rotation.detach().to(**here).clone().requires_grad_()
    leaves["translation"] = pose.translation.detach().to(**here).clone().requires_grad_()
    view = render(
        model,
        camera,
        SE3(leaves["rotation"], leaves["translation"]),
        settings=replace(settings, backend=backend),
        pixel_offsets=leaves["pixel_offsets"],
    )
    view = on_cpu(view)
    g = torch.Generator().manual_seed(5)
    loss = torch.zeros((), dtype=torch.float64)
    for image in (view.color, view.alpha, view.depth):
        if image is not None:
            factors = torch.randn(image.shape, generator=g, dtype=torch.float64)
            if weight is not None:
                factors = factors * weight.reshape(*weight.shape, *[1] * (image.dim() - 2))
            loss = loss + (image.double() * factors).sum()
    if loss.requires_grad:
        loss.backward()
    return view, {k: (torch.zeros_like(v) if v.grad is None else v.grad).double().cpu() for k, v in leaves.items()}


# gsplat's backward finds a pixel's transmittance again from 1 − α, rounded to 6e-8 where it may be 1e-4, and its kernels are
# compiled with fast division, root and exponential. On the CPU test_cuda.py computes them in float64.
BACKEND_LOOSENS = {"cpu": 1.0, "cuda": 10.0 if torch.cuda.is_available() else 1.0}


def clear_of_cut_offs(gaussians: Gaussians, camera: Camera, pose: SE3, settings: RenderSettings) -> Tensor:
    """`[H, W]` 1 where no α is within 1e-4 of 1/255 and no transmittance within 1e-2 of 1e-4 (relative), else 0.

    There rounding alone would take another side of the jump: the fast exponential rounds to 1e-6, and 1 − α may be 1e-3.
    """
    model = gaussians.detach().to(torch.float64)
    alphas = [
        reference.rasterize(
            model.means,
            model.quats,
            model.log_scales,
            model.opacity_logits,
            torch.zeros(len(model), 1, dtype=torch.float64),
            camera,
            pose.to_torch(torch.float64),
            near_plane=settings.near_plane,
            antialiased=settings.antialiased,
            alpha_min=reference.ALPHA_MIN * (1 + 1e-4 * side),
            transmittance_min=reference.TRANSMITTANCE_MIN * (1 + 1e-2 * side),
        )[1]
        for side in (-1, 1)
    ]
    return ((alphas[0] - alphas[1]).abs() < 1e-12).double()


def assert_backends_agree(
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings,
    pose: SE3 = POSE,
    loosen: float = 1.0,
    backend: str = "cpu",
) -> None:
    """`loosen` multiplies every tolerance."""
    loosen *= BACKEND_LOOSENS[backend]
    clear = clear_of_cut_offs(gaussians, camera, pose, settings) if backend == "cuda" else None
    fast, fast_gradients = value_and_gradients(backend, gaussians, camera, pose, settings, clear)
    slow, slow_gradients = value_and_gradients("reference", gaussians, camera, pose, settings, clear)
    compared = torch.ones(slow.alpha.shape, dtype=torch.bool) if clear is None else clear > 0
    assert compared.float().mean() > 0.9
    # Pixels sum a few dozen float32 terms of order 1, each with a conic rounded to 6e-8 and multiplied by up to (20 px)².
    assert_close(fast.color[compared], slow.color[compared], 3e-5 * loosen, "color")
    assert_close(fast.alpha[compared], slow.alpha[compared], 3e-5 * loosen, "alpha")
    assert (fast.depth is None) == (slow.depth is None)
    if fast.depth is not None and slow.depth is not None:
        assert_close(fast.depth[compared], slow.depth[compared], 1e-4 * loosen, "depth")  # colours of order 3 instead of 1
    # The reference tests the bounding box, the compiled code the ellipse: it may leave out what touches no pixel, and nothing else.
    # gsplat tests the box rounded up to pixels, and may name more.
    assert backend == "cuda" or not (fast.visible & ~slow.visible).any()
    contributes = slow_gradients["opacity_logits"] != 0
    assert fast.visible[contributes].all()
    for name, expected in slow_gradients.items():
        # The running remainder of a pixel carries 1e-7 of its whole colour and is divided by 1 − α ≥ 1e-3; a gradient then sums
        # hundreds of pixels of either sign: 1e-4 of the Gaussian's own largest component, and 2e-5 of the tensor's largest.
        scale = expected.abs().max()
        own = expected.abs().reshape(len(expected), -1).amax(1) if len(expected) else expected.new_zeros(0)
        allowed = (1e-4 * own + 2e-5 * scale + 1e-12) * loosen
        error = (fast_gradients[name] - expected).abs().reshape(len(expected), -1)
        assert torch.isfinite(fast_gradients[name]).all(), name
        if error.numel():
            worst = (error.amax(1) / allowed).max().item()
            assert worst <= 1.0, f"gradient of {name}: {worst:.3g} times what is allowed"


def assert_close(actual: Tensor, expected: Tensor, tolerance: float, name: str) -> None:
    assert torch.isfinite(actual).all(), name
    error = (actual.double() - expected.double()).abs().max().item() if actual.numel() else 0.0
    assert error <= tolerance, f"{name}: {error:.3g} > {tolerance:.3g}"


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("backend", COMPILED)
def test_compiled_equals_reference(backend: str, degree: int, channels: int, antialiased: bool) -> None:
    # 37 × 21: both axes end inside a tile, and there is more than one tile along each.
    settings = RenderSettings(with_depth=channels == 3 or degree % 2 == 0, antialiased=antialiased)
    assert_backends_agree(cloud(150, degree, channels, seed=degree), pinhole(37, 21), settings, backend=backend)


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (5, 40), (33, 15)])
@pytest.mark.parametrize("backend", COMPILED)
def test_compiled_equals_reference_at_any_image_size(backend: str, size: tuple[int, int]) -> None:
    assert_backends_agree(cloud(60, 1, 3), pinhole(*size, focal=30.0), RenderSettings(with_depth=True), backend=backend)


@pytest.mark.parametrize("backend", COMPILED)
def test_compiled_equals_reference_behind_an_opaque_crowd(backend: str) -> None:
    # Every pixel is spent after a few of 300 large Gaussians: the early end of a tile, forward and backward.
    crowd = cloud(300, 0, 3, size=0.5)
    crowd = replace(crowd, opacity_logits=crowd.opacity_logits + 3.0)
    assert draw(crowd, pinhole(40, 24), POSE, backend).alpha.min() > 0.99
    # 1 − α is a few 1e-3 all over, so the remainder's rounding is divided by that everywhere.
    assert_backends_agree(crowd, pinhole(40, 24), RenderSettings(), loosen=10.0, backend=backend)


def degenerate(kind: str, near: float = 0.5) -> Gaussians:
    """One Gaussian seen from the origin along z, wrong in one way."""
    mean, sigma, logit, quat = [0.05, -0.1, 3.0], [0.2, 0.15, 0.3], 1.0, [0.9, 0.3, -0.2, 0.1]
    if kind == "behind":
        mean = [0.0, 0.0, -2.0]
    elif kind == "at the camera":
        mean = [0.0, 0.0, 0.0]
    elif kind == "on the near plane":
        mean = [0.0, 0.0, near]
    elif kind == "just beyond the near plane":
        mean = [0.0, 0.0, float(np.nextafter(np.float32(near), np.float32(1)))]
    elif kind == "in the camera's plane":
        mean = [1.0, 0.0, 0.0]
    elif kind == "off screen":
        mean = [30.0, 0.0, 3.0]
    elif kind == "off screen, reaching in":
        mean, sigma = [4.0, 0.5, 3.0], [1.5, 0.8, 0.3]
    elif kind == "tiny":
        sigma = [1e-12] * 3
    elif kind == "huge":
        sigma = [1e3, 2e3, 3e3]
    elif kind == "absurdly huge":
        sigma = [1e15] * 3
    elif kind == "flat":
        sigma = [0.5, 0.4, 1e-9]
    elif kind == "needle":
        sigma, quat = [2.0, 1e-6, 1e-6], [0.9, 0.1, 0.2, 0.5]
    elif kind == "absurd needle":
        sigma, quat = [1e5, 1e-6, 1e-6], [0.9, 0.1, 0.2, 0.5]
    elif kind == "no opacity":
        logit = -1e4
    elif kind == "just too faint":
        logit = math.log(1 / 254) - 1e-3  # opacity a little below 1/255
    elif kind == "saturated":  # α is held at 0.999 over many pixels
        sigma, logit = [2.0, 1.5, 3.0], 1e4
    elif kind == "long quaternion":
        quat = [1e4, 2e4, -1e4, 3e4]
    elif kind == "short quaternion":
        quat = [1e-6, 2e-6, -1e-6, 3e-6]
    else:
        raise AssertionError(kind)
    return Gaussians(
        torch.tensor([mean]),
        torch.tensor([quat]),
        torch.tensor([sigma]).log(),
        torch.tensor([logit]),
        torch.linspace(-0.3, 0.8, 27).reshape(1, 9, 3),
    )


INVISIBLE = [
    "behind",
    "at the camera",
    "on the near plane",
    "in the camera's plane",
    "off screen",
    "no opacity",
    "just too faint",
]
VISIBLE = [
    "just beyond the near plane",
    "off screen, reaching in",
    "tiny",
    "huge",
    "flat",
    "needle",
    "saturated",
    "long quaternion",
    "short quaternion",
]


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("kind", INVISIBLE + VISIBLE)
@pytest.mark.parametrize("backend", COMPILED)
def test_compiled_equals_reference_on_degenerate_gaussians(backend: str, kind: str, antialiased: bool) -> None:
    camera, settings = pinhole(37, 21), RenderSettings(near_plane=0.5, with_depth=True, antialiased=antialiased)
    alone = degenerate(kind)
    if not antialiased:  # anti-aliasing rightly fades what is thinner than a pixel
        assert draw(alone, camera, identity(), backend, near_plane=0.5).visible.item() == (kind in VISIBLE)
    # A conic cancels as (length / width)² of what is drawn: 4e3 for the needle, 1e6 for the huge one.
    loosen = {"needle": 20.0, "flat": 3.0, "huge": 3.0}.get(kind, 1.0)
    assert_backends_agree(alone, camera, settings, identity(), loosen, backend=backend)
    shifted = replace(cloud(40, 2, 3), means=cloud(40, 2, 3).means + torch.tensor([0.0, 0.0, 3.0]))
    assert_backends_agree(joined(shifted, alone, shifted), camera, settings, identity(), loosen, backend=backend)


@pytest.mark.parametrize("kind", ["absurdly huge", "absurd needle"])
def test_beyond_float32_nothing_becomes_nan(kind: str) -> None:
    # Their conics have no determinant left in float32: the compiled code may leave them out, but must not spoil the rest.
    shifted = replace(cloud(40, 2, 3), means=cloud(40, 2, 3).means + torch.tensor([0.0, 0.0, 3.0]))
    view, gradients = value_and_gradients(
        "cpu", joined(shifted, degenerate(kind)), pinhole(37, 21), identity(), RenderSettings(with_depth=True)
    )
    for name, value in {"color": view.color, "alpha": view.alpha, **gradients}.items():
        assert torch.isfinite(value).all(), name


@pytest.mark.parametrize("with_depth", [False, True])
@pytest.mark.parametrize("backend", BACKENDS)
def test_no_gaussian_and_all_culled_are_black(backend: str, with_depth: bool) -> None:
    camera, settings = pinhole(20, 18), RenderSettings(with_depth=with_depth)
    behind = replace(cloud(5), means=cloud(5).means - torch.tensor([0.0, 0.0, 50.0]))
    for model in (cloud(0), behind):
        view, gradients = value_and_gradients(backend, model, camera, POSE, settings)
        assert view.color.shape == (18, 20, 3) and view.alpha.shape == (18, 20)
        assert not view.color.any() and not view.alpha.any() and not view.visible.any()
        assert all(not g.any() for g in gradients.values())


@pytest.mark.parametrize("kind", VISIBLE)
@pytest.mark.parametrize("backend", COMPILED)
def test_equal_depth_composites_in_model_order(backend: str, kind: str) -> None:
    red, blue = degenerate(kind), degenerate(kind)
    red.sh[:, :, 0] += 1.0
    blue.sh[:, :, 2] += 1.0
    camera = pinhole(37, 21)
    settings = RenderSettings(near_plane=0.5)
    loosen = {"needle": 20.0}.get(kind, 1.0)
    assert_backends_agree(joined(red, blue), camera, settings, identity(), loosen, backend=backend)
    first = draw(joined(red, blue), camera, identity(), backend, near_plane=0.5).color
    second = draw(joined(blue, red), camera, identity(), backend, near_plane=0.5).color
    assert (first[..., 0] > second[..., 0]).any() and not (first[..., 0] < second[..., 0] - 1e-6).any()


def test_gradients_reach_only_what_asks_for_them() -> None:
    model = cloud(40, 1, 3)
    everything = value_and_gradients("cpu", model, pinhole(37, 21), POSE, RenderSettings())[1]
    sh = model.sh.clone().requires_grad_()
    view = render(replace(model, sh=sh), pinhole(37, 21), POSE)
    g = torch.Generator().manual_seed(5)
    loss = sum((x.double() * torch.randn(x.shape, generator=g, dtype=torch.float64)).sum() for x in (view.color, view.alpha))
    loss.backward()  # the colour-only reverse
    torch.testing.assert_close(sh.grad.double(), everything["sh"], rtol=1e-6, atol=1e-9)
    pose = SE3(POSE.rotation.float().requires_grad_(), POSE.translation.float().requires_grad_())
    view = render(model, pinhole(37, 21), pose)
    g = torch.Generator().manual_seed(5)
    loss = sum((x.double() * torch.randn(x.shape, generator=g, dtype=torch.float64)).sum() for x in (view.color, view.alpha))
    loss.backward()
    torch.testing.assert_close(pose.rotation.grad.double(), everything["rotation"], rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(pose.translation.grad.double(), everything["translation"], rtol=1e-6, atol=1e-6)


# --- laws, of every back end -----------------------------------------------------------------------

# float32 rounding of the pose and of the parameters themselves, through a conic; the reference rounds in float64.
LAW_TOLERANCE = {"cpu": 5e-5, "cuda": 5e-5, "reference": 1e-9}


def assert_same_picture(a: Render, b: Render, tolerance: float) -> None:
    assert_close(a.color, b.color, tolerance, "color")
    assert_close(a.alpha, b.alpha, tolerance, "alpha")
    assert a.alpha.max() > 0.5  # two black pictures prove nothing


@pytest.mark.parametrize("backend", BACKENDS)
def test_permutation_leaves_the_picture(backend: str) -> None:
    model = cloud(120)
    shuffled = torch.randperm(120, generator=torch.Generator().manual_seed(1))
    permuted = Gaussians(**{k: v[shuffled] for k, v in model.tensors().items()})
    a, b = draw(model, pinhole(37, 21), POSE, backend), draw(permuted, pinhole(37, 21), POSE, backend)
    # Sorted by depth the sums are the same; torch's own vectorised loops may round a row by where it stands.
    assert_same_picture(a, b, {"cpu": 0.0, "cuda": 1e-6, "reference": 1e-12}[backend])
    assert torch.equal(a.visible[shuffled], b.visible)


@pytest.mark.parametrize("backend", BACKENDS)
def test_moving_world_and_camera_together_leaves_the_picture(backend: str) -> None:
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
@pytest.mark.parametrize("backend", BACKENDS)
def test_the_unit_of_length_is_free(backend: str, factor: float) -> None:
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
    assert_close(b.depth / factor, a.depth, 2e-4, "depth")


@pytest.mark.parametrize("backend", BACKENDS)
def test_length_and_sign_of_a_quaternion_mean_nothing(backend: str) -> None:
    model = cloud(120)
    lengths = torch.linspace(-3.0, 7.0, 120)[:, None]
    assert_same_picture(
        draw(model, pinhole(37, 21), POSE, backend),
        draw(replace(model, quats=model.quats * lengths), pinhole(37, 21), POSE, backend),
        5e-5,  # the product is rounded to the model's float32
    )


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_opacity_is_black(backend: str) -> None:
    view = draw(replace(cloud(50), opacity_logits=torch.full((50,), -30.0)), pinhole(37, 21), POSE, backend)
    assert not view.color.any() and not view.alpha.any() and not view.visible.any()


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("backend", BACKENDS)
def test_one_gaussian_known_answer(backend: str, antialiased: bool) -> None:
    # σ = 0.3 at depth 4 through f = 40 is 3 px; with the blur, 9.3 px². Anti-aliased: opacity × √(9·9 / (9.3·9.3)) = × 9/9.3.
    camera = Camera("PINHOLE", 33, 33, 40.0, 40.0, 16.5, 16.5)
    view = draw(gray_blob((0, 0, 4.0), 0.3, 2.0, 0.7), camera, identity(), backend, with_depth=True, antialiased=antialiased)
    y, x = torch.meshgrid(torch.arange(33) - 16.0, torch.arange(33) - 16.0, indexing="ij")
    opacity = 1 / (1 + math.exp(-2.0)) * (9 / 9.3 if antialiased else 1.0)
    expected = opacity * torch.exp(-(x * x + y * y) / (2 * 9.3))
    expected = torch.where(expected >= 1 / 255, expected, torch.zeros(()))
    assert_close(view.alpha, expected, 2e-6, "alpha")
    assert_close(view.color[..., 0], 0.7 * expected, 2e-6, "color")
    assert_close(view.depth, 4.0 * expected, 1e-5, "depth")
    assert (view.alpha == 0).any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_an_opaque_gaussian_lets_a_thousandth_through(backend: str) -> None:
    camera = Camera("PINHOLE", 17, 17, 40.0, 40.0, 8.5, 8.5)
    front, back = gray_blob((0, 0, 2.0), 5.0, 20.0, 0.6), gray_blob((0, 0, 4.0), 10.0, 20.0, 1.0)
    view = draw(joined(back, front), camera, identity(), backend)
    # The other would let 1e-6 of the light through, under 1e-4: the pixel is finished before it.
    assert view.color[8, 8, 0].item() == pytest.approx(0.999 * 0.6, abs=1e-6)
    assert view.alpha[8, 8].item() == pytest.approx(0.999, abs=1e-6)
    thin = replace(front, opacity_logits=torch.tensor([0.0]))
    view = draw(joined(back, thin), camera, identity(), backend)
    assert view.color[8, 8, 0].item() == pytest.approx(0.5 * 0.6 + 0.5 * 0.999 * 1.0, abs=1e-6)


@pytest.mark.parametrize("backend", BACKENDS)
def test_over_a_background(backend: str) -> None:
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
@pytest.mark.parametrize("backend", BACKENDS)
def test_channel_weights_are_the_weighted_sum_of_the_channels(backend: str, with_depth: bool) -> None:
    weights = (0.299, 0.587, 0.114)
    full = draw(cloud(80), pinhole(37, 21), POSE, backend, with_depth=with_depth)
    gray = draw(cloud(80), pinhole(37, 21), POSE, backend, with_depth=with_depth, channel_weights=weights)
    assert gray.color.shape == (21, 37, 1)
    assert_close(gray.color[..., 0], full.color @ torch.tensor(weights, dtype=full.color.dtype), 1e-6, "gray")
    assert_close(gray.alpha, full.alpha, 0.0, "alpha")


@pytest.mark.parametrize("pixel", [(3, 7), (15, 16), (31, 0)])
@pytest.mark.parametrize("backend", BACKENDS)
def test_pixel_centres_are_at_half_integers(backend: str, pixel: tuple[int, int]) -> None:
    camera = Camera("PINHOLE", 33, 20, 41.0, 43.0, 15.2, 11.9)
    i, j = pixel
    z = 2.5
    point = ((i + 0.5 - camera.cx) / camera.fl_x * z, (j + 0.5 - camera.cy) / camera.fl_y * z, z)
    image = draw(gray_blob(point, 1e-6, 3.0), camera, identity(), backend).alpha
    assert image.argmax().item() == j * 33 + i
    # Only the 0.3 px² blur is left: the next pixel centre is exp(−1 / 0.6) of the peak, on either side.
    left, right = (image[j, k].item() / image[j, i].item() for k in (i - 1, i + 1))
    assert left == pytest.approx(math.exp(-1 / 0.6), rel=2e-4) and right == pytest.approx(math.exp(-1 / 0.6), rel=2e-4)


@pytest.mark.parametrize("backend", BACKENDS)
def test_depth_of_a_plane(backend: str) -> None:
    g = torch.Generator().manual_seed(0)
    plane = replace(cloud(200, 0, 1), log_scales=torch.full((200, 3), math.log(0.2)), opacity_logits=torch.full((200,), 1.0))
    xy = torch.rand(200, 2, generator=g) * 4 - 2
    plane = replace(plane, means=torch.cat([xy, torch.full((200, 1), 3.25)], dim=1))
    view = draw(plane, pinhole(37, 21), identity(), backend, with_depth=True)
    covered = view.alpha > 0.05
    assert covered.float().mean() > 0.9
    torch.testing.assert_close((view.depth / view.alpha)[covered], torch.full_like(view.alpha[covered], 3.25), rtol=1e-5, atol=0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_pixel_offsets_move_the_picture(backend: str) -> None:
    model, camera = cloud(60, 0).to(**home(backend)), pinhole(40, 30)
    offset = torch.tensor([2.0, 3.0], **home(backend)).expand(60, 2)
    settings = RenderSettings(backend=backend)
    moved = render(model, camera, POSE, settings=settings, pixel_offsets=offset).color.cpu()
    still = render(model, camera, POSE, settings=settings).color.cpu()
    assert still.max() > 0.5
    assert_close(moved[3:, 2:], still[:-3, :-2], 5e-5, "moved")  # float32 centres round differently 3 px on


@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("backend", BACKENDS)
def test_fewer_bands_are_the_model_without_them(backend: str, degree: int) -> None:
    model = cloud(60, 3)
    cut = replace(model, sh=model.sh.clone())
    cut.sh[:, coefficients(degree) :] = 0.0
    a = draw(model, pinhole(37, 21), POSE, backend, sh_degree=degree)
    assert_same_picture(a, draw(cut, pinhole(37, 21), POSE, backend), 1e-6)
    assert (a.color - draw(model, pinhole(37, 21), POSE, backend).color).abs().max() > 0.01


def test_reference_blocks_of_pixels_are_invisible(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = draw(cloud(30), pinhole(37, 21), POSE, "reference")
    monkeypatch.setattr(reference, "_PIXELS_AT_ONCE", 30 * 100)
    assert_same_picture(whole, draw(cloud(30), pinhole(37, 21), POSE, "reference"), 1e-15)


def all_bits(model: Gaussians) -> list[Tensor]:
    view, gradients = value_and_gradients("cpu", model, pinhole(100, 70), POSE, RenderSettings(with_depth=True))
    assert view.depth is not None
    return [view.color.detach(), view.alpha.detach(), view.depth.detach(), *gradients.values()]


def test_repetition_is_bit_identical() -> None:
    for a, b in zip(all_bits(cloud(500)), all_bits(cloud(500)), strict=True):
        assert torch.equal(a, b)


def test_the_number_of_threads_is_invisible() -> None:
    # Numba takes its number of threads when it starts, and this process may have one: a process of its own with four.
    program = """
import sys, numba, torch
sys.path.insert(0, sys.argv[1])
from tests.renderer.test_render import all_bits, cloud
results = []
for threads in (1, 2, 3, 4):
    numba.set_num_threads(threads)
    results.append(all_bits(cloud(500)))
assert all(torch.equal(a, b) for other in results[1:] for a, b in zip(results[0], other, strict=True))
print("the same")
"""
    done = subprocess.run(
        [sys.executable, "-c", program, str(Path(__file__).parents[2])],
        env={**os.environ, "NUMBA_NUM_THREADS": "4"},
        capture_output=True,
        text=True,
    )
    assert done.stdout.strip() == "the same", done.stderr


# --- against gsplat's own PyTorch functions --------------------------------------------------------


@pytest.fixture
def rival() -> Callable[..., Tensor]:
    """`render` of the prototype that composites gsplat's PyTorch projection by the rules of its CUDA kernel."""
    folder = Path(os.environ.get("RTGS_PROTOTYPES", Path(__file__).parents[3] / "shared" / "prototypes"))
    if not (folder / "torch_rival.py").exists():
        pytest.skip("torch_rival.py is not here; RTGS_PROTOTYPES names its folder")
    threads, modules, path = torch.get_num_threads(), set(sys.modules), list(sys.path)
    own: dict[str, ModuleType | None] = {name: sys.modules.pop(name, None) for name in ("common", "scene", "torch_rival")}
    sys.path.insert(0, str(folder))
    try:
        pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed")
        return importlib.import_module("torch_rival").render
    finally:  # its import changes the number of threads and takes common names
        torch.set_num_threads(threads)
        sys.path[:] = path
        for name, module in own.items():
            if name not in modules:
                sys.modules.pop(name, None)
            if module is not None:
                sys.modules[name] = module


def test_reference_equals_gsplat(rival: Callable[..., Tensor]) -> None:
    width, height = 37, 21
    camera = pinhole(width, height)
    expected_leaves = {k: v.double().requires_grad_() for k, v in cloud(150).tensors().items()}
    expected_pose = torch.eye(4, dtype=torch.float64)
    expected_pose[:3, :3], expected_pose[:3, 3] = POSE.rotation, POSE.translation
    expected_pose.requires_grad_()
    e = expected_leaves
    expected = rival(
        e["means"],
        e["quats"],
        e["log_scales"].exp(),
        e["opacity_logits"].sigmoid(),
        e["sh"],
        expected_pose,
        torch.tensor(camera.matrix),
        width,
        height,
        3,
    )
    leaves = {k: v.double().requires_grad_() for k, v in cloud(150).tensors().items()}
    pose = SE3(POSE.rotation.clone().requires_grad_(), POSE.translation.clone().requires_grad_())
    view = render(Gaussians(**leaves), camera, pose, settings=RenderSettings(backend="reference"))
    actual = torch.cat([view.color, view.alpha[..., None]], dim=-1)
    # Two float64 programs for one formula; gsplat guards its divisions and square roots with constants up to 1e-6.
    torch.testing.assert_close(actual, expected, rtol=0, atol=1e-6)
    weights = torch.randn(expected.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    (expected * weights).sum().backward()
    (actual * weights).sum().backward()
    gradients = {k: (leaves[k].grad, e[k].grad) for k in NAMES}
    # gsplat finds the camera centre by inverting the matrix, we by the transpose: they differ off the rotations, so compare what
    # a rotation can do, the antisymmetric part of Rᵀ·G.
    turning = [POSE.rotation.T @ g for g in (pose.rotation.grad, expected_pose.grad[:3, :3])]
    gradients["rotation"] = (turning[0] - turning[0].T, turning[1] - turning[1].T)
    gradients["translation"] = (pose.translation.grad, expected_pose.grad[:3, 3])
    for name, (a, b) in gradients.items():
        assert b.abs().max() > 1e-3
        torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-5 * b.abs().max().item(), msg=lambda m, name=name: f"{name}: {m}")


# --- what is refused -------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["OPENCV", "RADIAL", "SIMPLE_RADIAL", "OPENCV_FISHEYE"])
def test_a_lens_is_refused(model: str) -> None:
    with pytest.raises(RtgsError, match=f"{model}.*undistort"):
        render(cloud(3), replace(pinhole(20, 20), model=model, k1=0.1), POSE)


def test_bands_the_model_does_not_have_are_refused() -> None:
    with pytest.raises(RtgsError, match="sh_degree 2 asked, the model has 1"):
        render(cloud(3, 1), pinhole(20, 20), POSE, settings=RenderSettings(sh_degree=2))


def test_up_to_eight_channels_are_drawn_and_more_refused() -> None:
    assert_backends_agree(cloud(40, 1, 8), pinhole(37, 21), RenderSettings())
    assert_backends_agree(cloud(40, 1, 2), pinhole(37, 21), RenderSettings())
    with pytest.raises(RtgsError, match=r"9 channels.*8"):
        render(cloud(3, 1, 9), pinhole(20, 20), POSE)
    with pytest.raises(RtgsError, match=r"9 channels.*8"):
        render(cloud(3, 1, 8), pinhole(20, 20), POSE, settings=RenderSettings(with_depth=True))
    assert draw(cloud(3, 1, 6), pinhole(20, 20), POSE, "reference").color.shape == (20, 20, 6)


@pytest.mark.parametrize("backend", BACKENDS)
def test_channel_weights_of_another_length_are_refused(backend: str) -> None:
    with pytest.raises(RtgsError, match=r"channel_weights.*3.*1"):
        draw(cloud(3, 1, 1), pinhole(20, 20), POSE, backend, channel_weights=(0.3, 0.6, 0.1))
