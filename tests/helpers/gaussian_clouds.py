"""Gaussian models and cameras that the renderer is tested with."""

from __future__ import annotations

import math

import numpy as np
import torch

from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.maths.sh import C0, coefficients
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians

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


def shell(n: int, generator: torch.Generator, *, size: float, spread: float, coefficients: int = 1) -> Gaussians:
    """A textured shell of radius 0.7 to 1 about the origin.

    Args:
        size, spread: median of the Gaussians' standard deviations, and the standard deviation of their logarithms.
        coefficients: of the harmonics.
    """
    directions = torch.nn.functional.normalize(torch.randn(n, 3, generator=generator), dim=1)
    return Gaussians(
        directions * (0.7 + 0.3 * torch.rand(n, 1, generator=generator)),
        torch.randn(n, 4, generator=generator),
        math.log(size) + spread * torch.randn(n, 3, generator=generator),
        torch.full((n,), 2.0),
        (torch.rand(n, coefficients, 3, generator=generator) - 0.5) / C0,
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
