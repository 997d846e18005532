"""What the Gaussians cover of the photographs, before anything is solved: the prior, the preconditioner's blocks and the ridge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rtgs.maths import sh
from rtgs.thermal.design import Design
from rtgs.thermal.frames import ThermalFrames
from rtgs.thermal.settings import LinearSettings


@dataclass(frozen=True, eq=False)
class Coverage:
    """Sums of compositing weights over all frames.

    Attributes:
        pixels: `[N + 1]`, Σ of the weights of each Gaussian and of the background: how many pixels it covers.
        prior: `[D]`, the unknowns' prior. Band 0 and the background: the mean of the pixels covered. Higher bands: 0.
        blocks: `[N, K, K]`, for the preconditioner (`least_squares.preconditioner`).
    """

    pixels: Tensor
    prior: Tensor
    blocks: Tensor


def measure_coverage(
    design: Design,
    data: ThermalFrames,
    settings: LinearSettings,
    each: Callable[[], None] = lambda: None,
    frames: Sequence[int] | None = None,
    unseen: Tensor | None = None,
) -> Coverage:
    """Coverage of all Gaussians, by one pass over the frames.

    Args:
        frames: indices of those that count; None: all.
        unseen: `[N + 1]`, prior of what no pixel sees; None: the scene's mean.
        each: called after each frame.
    """
    n, k = design.gaussians, design.coefficients
    frames = range(len(data)) if frames is None else frames
    scene_mean = sum(float((data.valid * data.images[f]).sum()) for f in frames) / (len(frames) * float(data.valid.sum()))
    sums, blocks = torch.zeros(n + 1, 2), torch.zeros(n, k, k)
    for f in frames:
        about_mean = torch.stack([data.valid * (data.images[f] - scene_mean), data.valid], dim=-1)
        colors, background = design.weights(f, about_mean)
        sums += torch.cat([colors, background[None]])
        design.add_blocks(f, colors[:, 1].contiguous(), blocks)
        each()
    if unseen is None:
        means = scene_mean + sums[:, 0] / (sums[:, 1] + settings.ridge_px)
    else:
        means = unseen + (sums[:, 0] + sums[:, 1] * (scene_mean - unseen)) / (sums[:, 1] + settings.ridge_px)
    prior = torch.zeros(design.size)
    design.harmonics(prior)[:, 0] = means[:n] / sh.C0
    prior[-1] = means[n]
    return Coverage(sums[:, 1], prior, blocks)


def ridge(design: Design, pixels: Tensor, factor: float, settings: LinearSettings) -> Tensor:
    """`[D]`: the ridge at `factor` times its default strength.

    C0² makes it a ridge on a band's mean square over all directions.

    Args:
        pixels: `[N + 1]`, `Coverage.pixels`.
    """
    out = torch.full((design.size,), settings.ridge_px * factor)
    bands = design.harmonics(out)
    bands[:, 1:] += settings.ridge_share * factor * pixels[:-1, None]
    bands *= sh.C0**2
    return out
