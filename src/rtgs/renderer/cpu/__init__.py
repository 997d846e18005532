"""The Numba back end: the same two functions as `reference`, compiled, float32.

| file         | what it holds                                                             |
|--------------|---------------------------------------------------------------------------|
| `arguments`  | the arrays that kernels are given                                         |
| `sh`         | colours from spherical harmonics                                          |
| `projection` | Gaussians to splats in the picture, and gradients back                    |
| `motion`     | the derivative of the projection when the camera moves                    |
| `tiles`      | which splats touch which tile, in depth order                             |
| `splats`     | a view: projected and sorted; calls the kernels in turn                   |
| `blend`      | compositing: forwards, backwards, colours alone, with tangents            |
| `patch`      | the steps that all kernels which composite have in common                 |
| `weights`    | a view's weights, computed once and kept                                  |
| `layout`     | the columns of the arrays, and the sizes of patches and tiles             |
| `simd`       | sixteen numbers in one register                                           |
| `channels`   | loops over channels, written out when they are compiled                   |

Results do not depend on the number of threads: sums run over fixed blocks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.autograd.function import once_differentiable

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Geometry
from rtgs.renderer.cpu import motion, sh
from rtgs.renderer.cpu.arguments import Model, View, float32, float64
from rtgs.renderer.cpu.blend import blend_tangents
from rtgs.renderer.cpu.layout import CHUNKS, G_COLORS, MAX_CHANNELS
from rtgs.renderer.cpu.splats import Splats
from rtgs.renderer.settings import RenderSettings


def colors_from_sh(means: Tensor, coefficients: Tensor, camera_centre: Tensor) -> Tensor:
    """`[N, C]`: max(0, ½ + basis(direction from the camera) · sh), `coefficients` `[N, K, C]`."""
    return _ColorsFromSh.apply(means, coefficients, camera_centre)


def rasterize(
    geometry: Geometry,
    colors: Tensor,
    camera: Camera,
    camera_from_world: SE3,
    settings: RenderSettings,
    pixel_offsets: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """Image `[H, W, C]`, alpha `[H, W]` and visible `[N]`; see `reference.rasterize`.

    Raises:
        RtgsError: more colour channels than the kernels are written out for, or none.
    """
    check_channels(colors.shape[1])
    pose = camera_from_world.rotation, camera_from_world.translation
    return _Rasterize.apply(camera, settings, *geometry, colors, pixel_offsets, *pose)


def check_channels(channels: int) -> None:
    """Refuse more colour channels than a splat's cache line holds.

    Raises:
        RtgsError: so many channels, or none.
    """
    if not 1 <= channels <= MAX_CHANNELS:
        raise RtgsError(
            f"render: {channels} channels (depth counts as one); the cpu back end composites 1 to {MAX_CHANNELS} at once."
        )


def rasterize_with_tangents(
    geometry: Geometry,
    coefficients: Tensor,
    mixing: NDArray[np.float64],
    camera: Camera,
    camera_from_world: SE3,
    directions: NDArray[np.float64],
    settings: RenderSettings,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Image and tangents in one pass.

    Args:
        coefficients: `[N, K, C]`.
        mixing: `[O, C]`, which sums of the C colours are composited.
        directions: `[D, 10]` (see `motion`).

    Returns:
        image `[H, W, O]` (`O + 1` with depth, the last), alpha `[H, W]`, their derivatives `[D, H, W, O]` and `[D, H, W]`, and
        visible `[N]`.

    Raises:
        RtgsError: more channels than the kernels are written out for.
    """
    with_depth = settings.with_depth
    outputs = len(mixing) + with_depth
    check_channels(outputs)
    model, view = Model.of(geometry), View.of(camera, camera_from_world)
    n, ways = len(model.means), len(directions)
    centre, centre_rates = -(view.rotation.T @ view.translation), -directions[:, 3:6] @ view.rotation
    colors, slopes = np.empty((n, outputs), np.float32), np.empty((n, len(mixing), 3), np.float32)
    plain = np.empty((n, len(mixing)), np.float32) if with_depth else colors
    sh.mixed_colors_and_slopes(model.means, float32(coefficients), centre, mixing.astype(np.float32), plain, slopes)
    if with_depth:
        colors[:, :-1], colors[:, -1] = plain, model.means @ view.rotation[2] + view.translation[2]
    splats = Splats.of(model, np.empty((0, 2), np.float32), colors, view, settings.near_plane, settings.antialiased)
    tangents = np.empty(n * ways * (G_COLORS + outputs), np.float32)
    motion.move(model, view, settings.antialiased, splats.tiles, directions, slopes, centre_rates, with_depth, tangents)
    height, width = splats.shape
    image, alpha = np.empty((height, width, outputs), np.float32), np.empty((height, width), np.float32)
    d_image, d_alpha = np.empty((height, width, ways * outputs), np.float32), np.empty((height, width, ways), np.float32)
    blend_tangents(splats.lists, tangents, (0,) * outputs, (0,) * ways, image, alpha, d_image, d_alpha)
    return (
        torch.from_numpy(image),
        torch.from_numpy(alpha),
        torch.from_numpy(d_image.reshape(height, width, ways, outputs)).permute(2, 0, 1, 3),
        torch.from_numpy(d_alpha).permute(2, 0, 1),
        torch.from_numpy(splats.tiles > 0),
    )


class _ColorsFromSh(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, means: Tensor, coefficients: Tensor, camera_centre: Tensor) -> Tensor:
        m, s, c = float32(means), float32(coefficients), float64(camera_centre)
        colors = np.empty((len(m), s.shape[2]), np.float32)
        sh.evaluate(m, s, c, colors)
        ctx.saved = (m, s, c, colors)
        return torch.from_numpy(colors)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, g_colors: Tensor) -> tuple[Tensor | None, ...]:
        m, s, c, colors = ctx.saved
        directional = ctx.needs_input_grad[0] or ctx.needs_input_grad[2]
        g_sh = np.empty(s.shape if ctx.needs_input_grad[1] else (0, *s.shape[1:]), np.float32)
        g_means = np.zeros_like(m)
        g_centre = np.zeros((CHUNKS, 3))
        sh.evaluate_backward(m, s, c, colors, float32(g_colors), directional, g_sh, g_means, g_centre)
        return (
            torch.from_numpy(g_means),
            torch.from_numpy(g_sh) if ctx.needs_input_grad[1] else None,
            torch.from_numpy(g_centre.sum(0)).to(torch.float32),
        )


_COLORS, _OFFSETS = 6, 7  # among the inputs of `_Rasterize`


class _Rasterize(torch.autograd.Function):
    """Inputs: camera, settings, the four tensors of the geometry, colours, pixel offsets, rotation and translation of the pose."""

    @staticmethod
    def forward(ctx: Any, camera: Camera, settings: RenderSettings, *tensors: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        *geometry, colors, pixel_offsets, rotation, translation = tensors
        model, view = Model(*map(float32, geometry)), View.of(camera, SE3(rotation, translation))
        offsets = np.empty((0, 2), np.float32) if pixel_offsets is None else float32(pixel_offsets)
        splats = Splats.of(model, offsets, float32(colors), view, settings.near_plane, settings.antialiased)
        picture = splats.blend()
        if any(ctx.needs_input_grad):
            ctx.saved = (model, settings.antialiased, splats, picture)
        visible = torch.from_numpy(splats.tiles > 0)
        ctx.mark_non_differentiable(visible)
        return torch.from_numpy(picture.image), torch.from_numpy(picture.alpha), visible

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, g_image: Tensor, g_alpha: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:
        model, antialiased, splats, picture = ctx.saved
        needs = ctx.needs_input_grad
        if not any(needed for k, needed in enumerate(needs) if k != _COLORS):  # colours alone
            g_colors = torch.from_numpy(splats.adjoint(float32(g_image), picture.used))
            return tuple(g_colors if k == _COLORS else None for k in range(len(needs)))
        found = splats.backward(model, antialiased, picture, float32(g_image), float32(g_alpha), needs[_OFFSETS])
        pose = torch.from_numpy(found.pose).to(torch.float32)
        return (
            None,
            None,
            *map(torch.from_numpy, found.model),
            torch.from_numpy(found.colors),
            torch.from_numpy(found.offsets) if needs[_OFFSETS] else None,
            pose[:9].reshape(3, 3),
            pose[9:],
        )
