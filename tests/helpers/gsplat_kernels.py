"""gsplat's compiled functions, in PyTorch: its contract without a GPU.

gsplat's own Python wrappers run as they are, and the compiled functions they call are replaced by these, which restate what the CUDA
sources do. So argument names, order, shapes, types, conventions and the gradients that gsplat passes on are checked on any machine; what
remains for a GPU is whether its kernels compute what their PyTorch twins do.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from gsplat.cuda import _torch_impl
from torch import Tensor

Vjp = tuple[Tensor, ...]


def blend(
    centres: Tensor,  # [N, 2]
    conics: Tensor,  # [N, 3]
    colors: Tensor,  # [N, C]
    opacities: Tensor,  # [N]
    width: int,
    height: int,
    tile_size: int,
    tile_offsets: Tensor,  # [tiles_y, tiles_x]
    ids: Tensor,
) -> Tensor:
    """`[H, W, C + 1]`: RasterizeToPixels3DGSFwd.cu, tile by tile; the numbers are that file's."""
    tiles_y, tiles_x = tile_offsets.shape
    starts = [*tile_offsets.flatten().tolist(), len(ids)]
    rows = []
    for j in range(tiles_y):
        row = []
        for i in range(tiles_x):
            listed = ids[starts[j * tiles_x + i] : starts[j * tiles_x + i + 1]].long()
            y = torch.arange(j * tile_size, min((j + 1) * tile_size, height), device=ids.device) + 0.5
            x = torch.arange(i * tile_size, min((i + 1) * tile_size, width), device=ids.device) + 0.5
            d = centres[listed] - torch.stack(torch.meshgrid(x, y, indexing="xy"), -1)[:, :, None]  # [h, w, listed, 2]
            a, b, c = conics[listed].unbind(-1)
            sigma = 0.5 * (a * d[..., 0] ** 2 + c * d[..., 1] ** 2) + b * d[..., 0] * d[..., 1]
            alpha = torch.clamp_max(opacities[listed] * torch.exp(-sigma), 0.999)
            alpha = torch.where((sigma < 0) | (alpha < 1 / 255), torch.zeros_like(alpha), alpha)
            after = torch.cumprod(1 - alpha, dim=-1)
            before = torch.cat([torch.ones_like(after[..., :1]), after[..., :-1]], dim=-1)[..., : len(listed)]
            weights = torch.where(after > 1e-4, alpha * before, torch.zeros_like(alpha))
            row.append(torch.cat([weights @ colors[listed], weights.sum(-1, keepdim=True)], dim=-1))
        rows.append(torch.cat(row, dim=1))
    return torch.cat(rows)


def project(
    means: Tensor, quats: Tensor, scales: Tensor, viewmat: Tensor, k: Tensor, width: int, height: int, eps2d: float
) -> Vjp:
    """Centres, depths, conics and compensations by gsplat's PyTorch functions, of Gaussians before the camera."""
    covars, _ = _torch_impl._quat_scale_to_covar_preci(quats, scales, compute_preci=False)
    _, centres, depths, conics, compensations = _torch_impl._fully_fused_projection(
        means, covars, viewmat[None], k[None], width, height, eps2d=eps2d, near_plane=-math.inf, calc_compensations=True
    )
    return centres[0], depths[0], conics[0], compensations[0]


def vjp(function: Callable[..., Vjp], inputs: list[Tensor], cotangents: list[Tensor]) -> Vjp:
    with torch.enable_grad():
        leaves = [x.detach().double().requires_grad_() for x in inputs]
        gradients = torch.autograd.grad(function(*leaves), leaves, [g.double() for g in cotangents], allow_unused=True)
    return tuple(torch.zeros_like(x) if g is None else g.to(x.dtype) for g, x in zip(gradients, inputs, strict=True))


def check_input(**tensors: Tensor | None) -> None:
    """The macro CHECK_INPUT, and that every floating tensor is read as float."""
    devices = set()
    for name, tensor in tensors.items():
        if tensor is not None:
            assert tensor.is_contiguous(), name
            assert tensor.dtype in (torch.float32, torch.int32, torch.int64), f"{name}: {tensor.dtype}"
            devices.add(tensor.device)
    assert len(devices) == 1


class Kernels:
    """What `gsplat.cuda._backend._C` offers, as far as the back end reaches it; float64 inside, float32 outside."""

    CameraModelType = None  # gsplat's accessor passes through it
    PINHOLE = "pinhole"

    @staticmethod
    def projection_ewa_3dgs_fused_fwd(
        means: Tensor,
        covars: None,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        viewmats: Tensor,
        ks: Tensor,
        width: int,
        height: int,
        eps2d: float,
        near_plane: float,
        far_plane: float,
        radius_clip: float,
        calc_compensations: bool,
        camera_model: str,
    ) -> Vjp:
        check_input(means=means, quats=quats, scales=scales, opacities=opacities, viewmats=viewmats, ks=ks)
        assert covars is None and camera_model == "pinhole" and viewmats.shape == (1, 4, 4)
        n = len(means)
        _ = means.numel() // (n * 3)  # the kernel's launcher divides so too: no Gaussian ends the process
        depth = means.double() @ viewmats[0, 2, :3].double() + viewmats[0, 2, 3].double()
        kept = torch.nonzero(~((depth.float() < near_plane) | (depth.float() > far_plane)))[:, 0]
        drawable, turns, sizes = (x[kept].double() for x in (means, quats, scales))
        projected = project(drawable, turns, sizes, viewmats[0].double(), ks[0].double(), width, height, eps2d)
        centres, depths, conics, compensations = projected
        opacity = opacities[kept].double() * (compensations if calc_compensations else 1.0)
        extend = torch.sqrt(2 * torch.log((opacity * 255).clamp_min(1.0))).clamp_max(3.33)
        variances = conics[:, [2, 0]] / (conics[:, 0] * conics[:, 2] - conics[:, 1] ** 2)[:, None]
        reach = torch.ceil(extend[:, None] * variances.sqrt())
        outside = ((centres + reach <= 0) | (centres - reach >= centres.new_tensor([width, height]))).any(-1)
        drawn = (opacity >= 1 / 255) & ~outside & ~(reach <= radius_clip).all(-1)
        # What is culled is never written: whatever was in that memory.
        radii = torch.zeros(1, n, 2, dtype=torch.int32, device=means.device)
        out = [means.new_full((1, n, *shape), math.nan) for shape in ((2,), (), (3,))]
        factors = means.new_zeros(1, n)
        radii[0, kept[drawn]] = reach[drawn].clamp_max(2**31 - 1).int()
        for target, value in zip((*out, factors), (centres, depths, conics, compensations), strict=True):
            target[0, kept[drawn]] = value[drawn].float()
        return radii, *out, factors

    @staticmethod
    def projection_ewa_3dgs_fused_bwd(
        means: Tensor,
        covars: None,
        quats: Tensor,
        scales: Tensor,
        viewmats: Tensor,
        ks: Tensor,
        width: int,
        height: int,
        eps2d: float,
        camera_model: str,
        radii: Tensor,
        conics: Tensor,
        compensations: Tensor | None,
        v_means2d: Tensor,
        v_depths: Tensor,
        v_conics: Tensor,
        v_compensations: Tensor | None,
        viewmats_requires_grad: bool,
    ) -> tuple[Tensor | None, ...]:
        check_input(v_means2d=v_means2d, v_depths=v_depths, v_conics=v_conics, v_compensations=v_compensations)
        drawn = (radii[0] > 0).all(-1)
        v_factors = torch.zeros_like(v_depths) if v_compensations is None else v_compensations
        cotangents = [v[0, drawn] for v in (v_means2d, v_depths, v_conics, v_factors)]

        def function(means: Tensor, quats: Tensor, scales: Tensor, viewmat: Tensor) -> Vjp:
            return project(means, quats, scales, viewmat, ks[0].double(), width, height, eps2d)

        *parts, v_viewmat = vjp(function, [means[drawn], quats[drawn], scales[drawn], viewmats[0]], cotangents)
        whole = [torch.zeros_like(x) for x in (means, quats, scales)]
        for target, part in zip(whole, parts, strict=True):
            target[drawn] = part
        return whole[0], None, whole[1], whole[2], v_viewmat[None] if viewmats_requires_grad else None

    @staticmethod
    def intersect_tile(
        means2d: Tensor,
        radii: Tensor,
        depths: Tensor,
        image_ids: None,
        gaussian_ids: None,
        n_images: int,
        tile_size: int,
        tiles_x: int,
        tiles_y: int,
        sort: bool,
        segmented: bool,
    ) -> Vjp:
        check_input(means2d=means2d, radii=radii, depths=depths)
        assert n_images == 1 and sort and not segmented and radii.dtype == torch.int32
        counts, keys, ids = _torch_impl._isect_tiles(means2d, radii, depths, tile_size, tiles_x, tiles_y, sort=False)
        keys, order = torch.sort(keys, stable=True)  # as a radix sort is: equal depths keep the model's order
        return counts, keys, ids[order]

    @staticmethod
    def intersect_offset(ids: Tensor, n_images: int, tiles_x: int, tiles_y: int) -> Tensor:
        assert ids.dtype == torch.int64
        return _torch_impl._isect_offset_encode(ids, n_images, tiles_x, tiles_y)

    @staticmethod
    def rasterize_to_pixels_3dgs_fwd(
        means2d: Tensor,
        conics: Tensor,
        colors: Tensor,
        opacities: Tensor,
        backgrounds: None,
        masks: None,
        width: int,
        height: int,
        tile_size: int,
        tile_offsets: Tensor,
        ids: Tensor,
    ) -> Vjp:
        check_input(means2d=means2d, conics=conics, colors=colors, opacities=opacities, offsets=tile_offsets, ids=ids)
        assert backgrounds is None and masks is None and ids.dtype == tile_offsets.dtype == torch.int32
        centres, shapes, shades, strengths = (x[0].double() for x in (means2d, conics, colors, opacities))
        picture = blend(centres, shapes, shades, strengths, width, height, tile_size, tile_offsets[0], ids).float()[None]
        last_ids = torch.zeros(1, height, width, dtype=torch.int32, device=ids.device)  # the backward below does without
        return picture[..., :-1].contiguous(), picture[..., -1:].contiguous(), last_ids

    @staticmethod
    def rasterize_to_pixels_3dgs_bwd(
        means2d: Tensor,
        conics: Tensor,
        colors: Tensor,
        opacities: Tensor,
        backgrounds: None,
        masks: None,
        width: int,
        height: int,
        tile_size: int,
        tile_offsets: Tensor,
        ids: Tensor,
        render_alphas: Tensor,
        last_ids: Tensor,
        v_colors: Tensor,
        v_alphas: Tensor,
        absgrad: bool,
    ) -> tuple[Tensor | None, ...]:
        check_input(v_colors=v_colors, v_alphas=v_alphas)
        listed = torch.unique(ids.long())  # what no tile lists is never read
        inverse = torch.zeros(means2d.shape[1], dtype=torch.int32, device=ids.device)
        inverse[listed] = torch.arange(len(listed), dtype=torch.int32, device=ids.device)
        tensors = (means2d, conics, colors, opacities)

        def function(centres: Tensor, shapes: Tensor, shades: Tensor, strengths: Tensor) -> Vjp:
            return (blend(centres, shapes, shades, strengths, width, height, tile_size, tile_offsets[0], inverse[ids.long()]),)

        parts = vjp(function, [x[0, listed] for x in tensors], [torch.cat([v_colors, v_alphas], dim=-1)[0]])
        whole = [torch.zeros_like(x) for x in tensors]
        for target, part in zip(whole, parts, strict=True):
            target[0, listed] = part
        return None, *whole
