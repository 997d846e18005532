"""gsplat 1.5.3's PyTorch functions on a CPU: its projection and harmonics, and compositing by the rules of its CUDA kernel, tile by
tile (gsplat's own PyTorch compositing calls a CUDA operator).

    python benchmarks/rivals/gsplat_torch.py SCENE.npz [float64]        driven by benchmarks/render.py

RTGS_PROTOTYPES names a folder with a `torch_rival.py` whose `render` is measured instead.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module

import torch
from gsplat.cuda._torch_impl import _fully_fused_projection, _quat_scale_to_covar_preci, _spherical_harmonics
from server import Arrays, load_scene, serve
from torch import Tensor

TILE = 16
ALPHA_MIN, ALPHA_MAX, TRANSMITTANCE_MIN = 1 / 255, 0.999, 1e-4


@torch.no_grad()
def tile_lists(centres: Tensor, radii: Tensor, depths: Tensor, columns: int, rows: int) -> list[Tensor]:
    """For each tile, row by row, the Gaussians whose box of `radii` touches it, front to back."""
    limit = torch.tensor([columns, rows])
    first = ((centres - radii) / TILE).floor().long().clamp(min=0).minimum(limit)
    last = ((centres + radii) / TILE).ceil().long().clamp(min=0).minimum(limit)
    width, height = (last - first).clamp(min=0).unbind(1)
    counts = width * height * (radii > 0).all(1)
    order = torch.argsort(depths, stable=True)
    gaussians = torch.repeat_interleave(order, counts[order])  # rising depth, so a stable sort by tile keeps it
    ends = torch.cumsum(counts[order], 0)
    within = torch.arange(len(gaussians)) - torch.repeat_interleave(ends - counts[order], counts[order])
    across = width[gaussians]
    tiles = (first[gaussians, 1] + within // across) * columns + first[gaussians, 0] + within % across
    by_tile = torch.argsort(tiles, stable=True)
    return list(gaussians[by_tile].split(torch.bincount(tiles, minlength=columns * rows).tolist()))


def render(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    sh: Tensor,
    camera_from_world: Tensor,
    intrinsics: Tensor,
    width: int,
    height: int,
) -> Tensor:
    """`[H, W, 4]`: colours and alpha."""
    covariances, _ = _quat_scale_to_covar_preci(quats, scales, True, False, triu=False)
    projected = _fully_fused_projection(means, covariances, camera_from_world[None], intrinsics[None], width, height)
    radii, centres, depths, conics = (x[0] for x in projected[:4])
    directions = means - torch.inverse(camera_from_world)[:3, 3]
    colors = torch.clamp_min(_spherical_harmonics(3, directions, sh) + 0.5, 0.0)
    colors = torch.cat([colors, torch.ones_like(colors[:, :1])], 1)  # the last one sums to alpha
    columns, rows = -(-width // TILE), -(-height // TILE)
    lists = tile_lists(centres, radii, depths, columns, rows)
    lines = []
    for row in range(rows):
        tiles = []
        for column in range(columns):
            ids = lists[row * columns + column]
            ys = torch.arange(row * TILE, min(row * TILE + TILE, height), dtype=means.dtype) + 0.5
            xs = torch.arange(column * TILE, min(column * TILE + TILE, width), dtype=means.dtype) + 0.5
            dx = (centres[ids, 0] - xs[:, None])[None]  # [1, w, n]
            dy = (centres[ids, 1] - ys[:, None])[:, None]  # [h, 1, n]
            a, b, c = conics[ids].unbind(1)
            power = 0.5 * (a * dx**2 + c * dy**2) + b * dx * dy
            alpha = torch.clamp_max(opacities[ids] * torch.exp(-power), ALPHA_MAX)
            alpha = torch.where((power < 0) | (alpha < ALPHA_MIN), 0.0, alpha)
            after = torch.cumprod(1 - alpha, dim=2)
            before = torch.cat([torch.ones_like(after[..., :1]), after[..., :-1]], dim=2)
            weights = torch.where(after > TRANSMITTANCE_MIN, alpha * before, 0.0)
            tiles.append(weights @ colors[ids])
        lines.append(torch.cat(tiles, 1))
    return torch.cat(lines, 0)


def main() -> None:
    dtype = torch.float64 if "float64" in sys.argv[2:] else torch.float32
    draw = render
    if folder := os.environ.get("RTGS_PROTOTYPES"):
        sys.path.insert(0, folder)
        draw = import_module("torch_rival").render
    torch.set_num_threads(int(os.environ["OMP_NUM_THREADS"]))  # the prototype sets one
    scene = {k: torch.tensor(v, dtype=dtype) for k, v in load_scene().items()}
    names = ("means", "quats", "log_scales", "opacity_logits", "sh")
    leaves = {k: scene[k].requires_grad_() for k in names}
    height, width, _ = scene["weights"].shape

    def image() -> Tensor:
        means, quats, log_scales, logits, sh = leaves.values()
        view = (scene["camera_from_world"], scene["intrinsics"], width, height)
        return draw(means, quats, log_scales.exp(), logits.sigmoid(), sh, *view)[..., :3]

    def forward() -> Arrays:
        with torch.no_grad():
            return {"image": image().numpy()}

    def both() -> Arrays:
        for leaf in leaves.values():
            leaf.grad = None
        drawn = image()
        (drawn * scene["weights"]).sum().backward()
        return {"image": drawn.detach().numpy()} | {k: v.grad.numpy() for k, v in leaves.items() if v.grad is not None}

    serve(forward, both)


if __name__ == "__main__":
    main()
