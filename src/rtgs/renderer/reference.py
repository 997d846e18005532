"""The specification of the renderer: plain PyTorch, any dtype, every Gaussian at every pixel.

EWA splatting (Zwicker et al. 2001) as 3DGS (Kerbl et al. 2023) uses it. Other back ends are tested against this file.
"""

from __future__ import annotations

import torch
from torch import Tensor

from rtgs.maths import sh
from rtgs.maths.geometry import SE3
from rtgs.maths.quaternions import rotations_from_quats
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Geometry
from rtgs.renderer.settings import ALPHA_MAX, COVARIANCE_BLUR_PX2, FRUSTUM_MARGIN, CutOffs, RenderSettings


def colors_from_sh(means: Tensor, coefficients: Tensor, camera_centre: Tensor) -> Tensor:
    """`[N, C]`: max(0, ½ + basis(direction from the camera) · sh), `coefficients` `[N, K, C]`."""
    directions = torch.nn.functional.normalize(means - camera_centre, dim=-1)
    degree = int(coefficients.shape[1] ** 0.5 + 0.5) - 1
    return torch.clamp_min(torch.einsum("nk,nkc->nc", sh.basis(directions, degree), coefficients) + 0.5, 0.0)


def project(geometry: Geometry, camera: Camera, camera_from_world: SE3) -> tuple[Tensor, Tensor, Tensor]:
    """Centres `[N, 2]` in pixels, covariances `[N, 2, 2]` in px² (no blur yet), depths `[N]`."""
    means, quats, log_scales, _ = geometry
    in_camera = means @ camera_from_world.rotation.T + camera_from_world.translation
    x, y, z = in_camera.unbind(-1)
    z = torch.where(z > 0, z, torch.ones_like(z))  # culled by the caller; keeps 0 and NaN out of the gradients
    fx, fy, cx, cy, width, height = camera.fl_x, camera.fl_y, camera.cx, camera.cy, camera.width, camera.height
    margin_x, margin_y = FRUSTUM_MARGIN * 0.5 * width / fx, FRUSTUM_MARGIN * 0.5 * height / fy
    slope_x = torch.clamp(x / z, -cx / fx - margin_x, (width - cx) / fx + margin_x)
    slope_y = torch.clamp(y / z, -cy / fy - margin_y, (height - cy) / fy + margin_y)
    zero = torch.zeros_like(z)
    jacobian = torch.stack([fx / z, zero, -fx * slope_x / z, zero, fy / z, -fy * slope_y / z], -1).reshape(-1, 2, 3)
    factor = jacobian @ camera_from_world.rotation @ (rotations_from_quats(quats) * torch.exp(log_scales)[:, None, :])
    return torch.stack([fx * x / z + cx, fy * y / z + cy], -1), factor @ factor.mT, in_camera[:, 2]


def rasterize(
    geometry: Geometry,
    colors: Tensor,
    camera: Camera,
    camera_from_world: SE3,
    settings: RenderSettings,
    pixel_offsets: Tensor | None = None,
    *,
    cut_offs: CutOffs | None = None,
    pairs_at_once: int = 1 << 24,
) -> tuple[Tensor, Tensor, Tensor]:
    """Composite front to back.

    Args:
        colors: `[N, C]`.
        settings: near plane and anti-aliasing count.
        pixel_offsets: `[N, 2]`, added to the projected centres: their gradient is the screen-space gradient.
        cut_offs: the package's unless given.
        pairs_at_once: pixel–Gaussian pairs held in memory together.

    Returns:
        image `[H, W, C]`, alpha `[H, W]` and visible `[N]`.
    """
    cut_offs = cut_offs or CutOffs()
    alpha_min, opacity_logits, dtype = cut_offs.alpha, geometry.opacity_logits, geometry.means.dtype
    centres, covariances, depths = project(geometry, camera, camera_from_world)
    if pixel_offsets is not None:
        centres = centres + pixel_offsets
    a, b, c = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    det_sharp = a * c - b * b
    a, c = a + COVARIANCE_BLUR_PX2, c + COVARIANCE_BLUR_PX2
    det = a * c - b * b
    opacities = torch.sigmoid(opacity_logits)
    if settings.antialiased:
        opacities = opacities * torch.sqrt(torch.clamp(det_sharp / det, min=1e-12))

    # What cannot reach the image is left out before sorting.
    reach = torch.sqrt(2 * torch.log(torch.clamp(opacities / max(alpha_min, 1e-30), min=1.0)))
    half_x, half_y = reach * torch.sqrt(a), reach * torch.sqrt(c)
    visible = (
        (depths > settings.near_plane)
        & (opacities > alpha_min)
        & torch.isfinite(det)
        & (centres[:, 0] + half_x > 0.5)
        & (centres[:, 0] - half_x < camera.width - 0.5)
        & (centres[:, 1] + half_y > 0.5)
        & (centres[:, 1] - half_y < camera.height - 0.5)
    ).detach()
    kept = torch.nonzero(visible)[:, 0]
    order = kept[torch.argsort(depths.detach()[kept], stable=True)]
    centres, a, b, c, det = centres[order], a[order], b[order], c[order], det[order]
    opacities, colors = opacities[order], colors[order]

    ys, xs = torch.meshgrid(
        torch.arange(camera.height, dtype=dtype) + 0.5, torch.arange(camera.width, dtype=dtype) + 0.5, indexing="ij"
    )
    pixels = torch.stack([xs, ys], -1).reshape(-1, 2)
    out = []
    for block in pixels.split(max(1, pairs_at_once // max(1, len(order)))):
        d = centres[None] - block[:, None]  # [P, N, 2]
        power = (0.5 * (c * d[..., 0] ** 2 + a * d[..., 1] ** 2) - b * d[..., 0] * d[..., 1]) / det
        alpha = torch.clamp_max(opacities * torch.exp(-power), ALPHA_MAX)
        alpha = torch.where(alpha >= alpha_min, alpha, torch.zeros_like(alpha))
        after = torch.cumprod(1 - alpha, dim=1)
        before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
        weights = torch.where(after > cut_offs.transmittance, alpha * before, torch.zeros_like(alpha))
        out.append(torch.cat([weights @ colors, weights.sum(1, keepdim=True)], dim=1))
    image = torch.cat(out).reshape(camera.height, camera.width, -1)
    return image[..., :-1], image[..., -1], visible
