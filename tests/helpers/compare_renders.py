"""Renders of one model by several back ends, and what they may differ by."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from tests.helpers.gaussian_clouds import POSE, pinhole
from torch import Tensor

from rtgs.config import Backend
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import Render, RenderSettings, reference, render
from rtgs.renderer.settings import ALPHA_MIN, TRANSMITTANCE_MIN, CutOffs

# gsplat's backward finds a pixel's transmittance again from 1 − α, rounded to 6e-8 where it may be 1e-4, and its kernels are
# compiled with fast division, root and exponential. On the CPU `gsplat_kernels` computes them in float64.
BACKEND_LOOSENS = {"cpu": 1.0, "cuda": 10.0 if torch.cuda.is_available() else 1.0}
# float32 rounding of the pose and of the parameters themselves, through a conic; the reference rounds in float64.
LAW_TOLERANCE = {"cpu": 5e-5, "cuda": 5e-5, "reference": 1e-9}


def home(backend: Backend) -> dict[str, Any]:
    """Where and in which precision a back end computes."""
    gpu = backend == "cuda" and torch.cuda.is_available()
    return {"device": "cuda" if gpu else "cpu", "dtype": torch.float64 if backend == "reference" else torch.float32}


def on_cpu(view: Render) -> Render:
    depth = None if view.depth is None else view.depth.cpu()
    return Render(view.color.cpu(), view.alpha.cpu(), depth, view.visible.cpu())


def draw(gaussians: Gaussians, camera: Camera, pose: SE3, backend: Backend, **settings: Any) -> Render:
    """In the back end's own precision."""
    with torch.no_grad():
        return on_cpu(render(gaussians.to(**home(backend)), camera, pose, settings=RenderSettings(backend=backend, **settings)))


def value_and_gradients(
    backend: Backend, gaussians: Gaussians, camera: Camera, pose: SE3, settings: RenderSettings, weight: Tensor | None = None
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


def clear_of_cut_offs(gaussians: Gaussians, camera: Camera, pose: SE3, settings: RenderSettings) -> Tensor:
    """`[H, W]` 1 where no α is within 1e-4 of 1/255 and no transmittance within 1e-2 of 1e-4 (relative), else 0.

    There rounding alone would take another side of the jump: the fast exponential rounds to 1e-6, and 1 − α may be 1e-3.
    """
    model = gaussians.detach().to(torch.float64)
    alphas = [
        reference.rasterize(
            model.geometry,
            torch.zeros(len(model), 1, dtype=torch.float64),
            camera,
            pose.to_torch(torch.float64),
            settings,
            cut_offs=CutOffs(ALPHA_MIN * (1 + 1e-4 * side), TRANSMITTANCE_MIN * (1 + 1e-2 * side)),
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
    backend: Backend = "cpu",
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


def assert_same_picture(a: Render, b: Render, tolerance: float) -> None:
    assert_close(a.color, b.color, tolerance, "color")
    assert_close(a.alpha, b.alpha, tolerance, "alpha")
    assert a.alpha.max() > 0.5  # two black pictures prove nothing


def all_bits(model: Gaussians) -> list[Tensor]:
    """A picture and all its gradients, by the compiled back end."""
    view, gradients = value_and_gradients("cpu", model, pinhole(100, 70), POSE, RenderSettings(with_depth=True))
    assert view.depth is not None
    return [view.color.detach(), view.alpha.detach(), view.depth.detach(), *gradients.values()]
