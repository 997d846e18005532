"""Forward mode: a picture and its derivatives along a few motions of the camera, in one pass.

To find one number (a scale, a focal length) takes one tangent picture. It costs a fraction of a reverse pass, and gives Gauss–Newton
its step, where reverse mode gives only a slope.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.autograd import forward_ad

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3
from rtgs.records.camera import INTRINSICS, Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import cpu
from rtgs.renderer.cpu.layout import MAX_DIRECTIONS
from rtgs.renderer.settings import Render, RenderSettings
from rtgs.renderer.view import active_sh, check, on_the_cpu, render

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Direction:
    """A way for a camera to move, per unit of one parameter ε.

    Attributes:
        rotation_rad, translation: a twist in the camera's own frame, `camera_from_world(ε) = exp(ε·twist) ∘ camera_from_world`: a
            point at p in camera coordinates moves by rotation × p + translation (world units).
        fl_x, fl_y, cx, cy: changes of the intrinsics, pixels.
    """

    rotation_rad: Vector = (0.0, 0.0, 0.0)
    translation: Vector = (0.0, 0.0, 0.0)
    fl_x: float = 0.0
    fl_y: float = 0.0
    cx: float = 0.0
    cy: float = 0.0

    @staticmethod
    def between(derivative: SE3, camera_from_world: SE3) -> Direction:
        """The twist for a pose whose `[R | t]` changes by `derivative` (Ṙ, ṫ; NumPy or torch)."""
        turn = np.asarray(derivative.rotation, dtype=np.float64) @ np.asarray(camera_from_world.rotation, dtype=np.float64).T
        translation = np.asarray(derivative.translation, dtype=np.float64) - turn @ np.asarray(camera_from_world.translation)
        x, y, z = (turn[2, 1] - turn[1, 2]) / 2, (turn[0, 2] - turn[2, 0]) / 2, (turn[1, 0] - turn[0, 1]) / 2
        return Direction((float(x), float(y), float(z)), tuple(float(v) for v in translation))  # type: ignore[arg-type]

    def array(self) -> np.ndarray:
        """`[10]`: rotation, translation, fl_x, fl_y, cx, cy."""
        rotation, translation, *intrinsics = astuple(self)
        return np.array([*rotation, *translation, *intrinsics])


@dataclass(frozen=True, eq=False)
class Tangents:
    """Derivatives of a `Render` by each direction's parameter: color `[K, H, W, C]`, alpha `[K, H, W]`, depth `[K, H, W]` or None."""

    color: Tensor
    alpha: Tensor
    depth: Tensor | None

    def over(self, background: Tensor) -> Tensor:
        """`[K, H, W, C]`: derivatives of `Render.over` a constant background `[C]`."""
        return self.color - self.alpha[..., None] * background


def render_with_tangents(
    gaussians: Gaussians,
    camera: Camera,
    camera_from_world: SE3,
    directions: Sequence[Direction],
    *,
    settings: RenderSettings | None = None,
) -> tuple[Render, Tangents]:
    """Render a model, and the derivative of the picture along each direction. Nothing here is tracked by autograd.

    The "cuda" back end has no forward mode; "cpu" takes its place.

    Raises:
        RtgsError: as `render`; the model is on a GPU; no direction or more than eight.
    """
    settings = on_the_cpu(settings or RenderSettings())
    check(gaussians, camera, settings)
    if not 1 <= len(directions) <= MAX_DIRECTIONS:
        raise RtgsError(f"render: {len(directions)} directions; tangents are taken along 1 to {MAX_DIRECTIONS} at once.")
    with torch.no_grad():
        if settings.backend == "reference":
            return _by_dual_numbers(gaussians, camera, camera_from_world, directions, settings)
        weights = settings.channel_weights
        mixing = np.eye(gaussians.channels) if weights is None else np.array([weights])
        ways = np.stack([d.array() for d in directions])
        image, alpha, d_image, d_alpha, visible = cpu.rasterize_with_tangents(
            gaussians.geometry,
            active_sh(gaussians, settings),
            mixing,
            camera,
            camera_from_world.to_torch(gaussians.means.dtype),
            ways,
            settings,
        )
    if not settings.with_depth:
        return Render(image, alpha, None, visible), Tangents(d_image, d_alpha, None)
    return Render(image[..., :-1], alpha, image[..., -1], visible), Tangents(d_image[..., :-1], d_alpha, d_image[..., -1])


def _by_dual_numbers(
    gaussians: Gaussians, camera: Camera, camera_from_world: SE3, directions: Sequence[Direction], settings: RenderSettings
) -> tuple[Render, Tangents]:
    dtype = gaussians.means.dtype
    pose = camera_from_world.to_torch(dtype)
    views: list[Render] = []
    tangents: list[tuple[Tensor, Tensor, Tensor | None]] = []
    for direction in directions:
        x, y, z = direction.rotation_rad
        turn = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=dtype)
        shift = torch.tensor(direction.translation, dtype=dtype)
        with forward_ad.dual_level():

            def dual(value: Tensor, rate: Tensor) -> Tensor:
                return forward_ad.make_dual(value.clone(), rate)

            moving = {k: dual(torch.tensor(getattr(camera, k), dtype=dtype), torch.tensor(getattr(direction, k), dtype=dtype))
                      for k in INTRINSICS}  # fmt: skip
            moved = SE3(dual(pose.rotation, turn @ pose.rotation), dual(pose.translation, turn @ pose.translation + shift))
            view = render(gaussians, replace(camera, **moving), moved, settings=settings)  # type: ignore[arg-type]

            def split(image: Tensor) -> tuple[Tensor, Tensor]:
                value, rate = forward_ad.unpack_dual(image)
                return value, torch.zeros_like(value) if rate is None else rate

            (color, d_color), (alpha, d_alpha) = split(view.color), split(view.alpha)
            depth, d_depth = (None, None) if view.depth is None else split(view.depth)
        views.append(Render(color, alpha, depth, view.visible))
        tangents.append((d_color, d_alpha, d_depth))
    depths = [t[2] for t in tangents if t[2] is not None]
    stacked = torch.stack([t[0] for t in tangents]), torch.stack([t[1] for t in tangents])
    return views[0], Tangents(*stacked, torch.stack(depths) if depths else None)
