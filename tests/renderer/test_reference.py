"""The reference renderer: against finite differences, and against gsplat's own PyTorch functions."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from tests.helpers.compare_renders import assert_close
from tests.helpers.gaussian_clouds import NAMES, POSE, cloud, pinhole
from tests.helpers.gradients import gradient_of
from torch import Tensor

from rtgs.maths.geometry import SE3
from rtgs.maths.sh import coefficients
from rtgs.records.gaussians import Gaussians, Geometry
from rtgs.renderer import RenderSettings, reference, render
from rtgs.renderer.settings import CutOffs


def named(name: str) -> Callable[[str], str]:
    """Puts the name before torch's message."""
    return lambda message: f"{name}: {message}"


@pytest.mark.thorough
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
        settings, everything = RenderSettings(near_plane=0.01, antialiased=antialiased), CutOffs(0.0, 0.0)
        geometry = Geometry(means, quats, log_scales, logits)
        image, alpha, visible = reference.rasterize(geometry, colors, camera, pose, settings, offsets, cut_offs=everything)
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


def test_reference_blocks_of_pixels_are_invisible() -> None:
    model, camera = cloud(30).to(torch.float64), pinhole(37, 21)
    colors = reference.colors_from_sh(model.means, model.sh, -(POSE.rotation.T @ POSE.translation))
    whole, blocks = (
        reference.rasterize(model.geometry, colors, camera, POSE, RenderSettings(), pairs_at_once=pairs)
        for pairs in (1 << 24, 30 * 100)
    )
    assert whole[1].max() > 0.5
    assert_close(blocks[0], whole[0], 1e-15, "color")
    assert_close(blocks[1], whole[1], 1e-15, "alpha")


def test_reference_equals_gsplat() -> None:
    pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed")
    import gsplat_torch

    width, height = 37, 21
    camera = pinhole(width, height)
    expected_leaves = {k: v.double().requires_grad_() for k, v in cloud(150).tensors().items()}
    expected_pose = torch.eye(4, dtype=torch.float64)
    expected_pose[:3, :3], expected_pose[:3, 3] = POSE.rotation, POSE.translation
    expected_pose.requires_grad_()
    e = expected_leaves
    expected = gsplat_torch.render(
        e["means"],
        e["quats"],
        e["log_scales"].exp(),
        e["opacity_logits"].sigmoid(),
        e["sh"],
        expected_pose,
        torch.tensor(camera.matrix),
        width,
        height,
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
    gradients = {k: (gradient_of(leaves[k]), gradient_of(e[k])) for k in NAMES}
    of_pose = gradient_of(expected_pose)
    # gsplat finds the camera centre by inverting the matrix, we by the transpose: they differ off the rotations, so compare what
    # a rotation can do, the antisymmetric part of Rᵀ·G.
    turning = [POSE.rotation.T @ g for g in (gradient_of(pose.rotation), of_pose[:3, :3])]
    gradients["rotation"] = (turning[0] - turning[0].T, turning[1] - turning[1].T)
    gradients["translation"] = (gradient_of(pose.translation), of_pose[:3, 3])
    for name, (a, b) in gradients.items():
        assert b.abs().max() > 1e-3
        torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-5 * b.abs().max().item(), msg=named(name))
