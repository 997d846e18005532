"""Grow and prune a Gaussian model while it trains, within a budget.

3DGS's adaptive density control (Kerbl et al. 2023, §5.2) with one change: instead of a gradient threshold, which decides the model's
size only indirectly, the number of Gaussians follows a schedule up to `max_gaussians`, and the Gaussians with the largest mean
screen-space gradient are the ones that multiply.
"""

from __future__ import annotations

import torch
from torch import Tensor

from rtgs.config import DensifyConfig
from rtgs.maths.adam import Adam
from rtgs.maths.quaternions import rotations_from_quats


def budget(config: DensifyConfig, pixels: int, points: int) -> int:
    """`max_gaussians`, or what suits images of this many pixels: more would only describe their noise."""
    if config.max_gaussians is not None:
        return config.max_gaussians
    assert config.pixels_each is not None  # `RgbConfig.resolved` fills it in
    return min(max(int(pixels / config.pixels_each), points, 10_000), 150_000)


class ScreenGradients:
    """Mean norm of each Gaussian's screen-space gradient since the last round."""

    def __init__(self, n: int) -> None:
        self.total = torch.zeros(n)
        self.count = torch.zeros(n)

    def add(self, gradient: Tensor, visible: Tensor, width: int, height: int) -> None:
        """`gradient` `[N, 2]` per pixel; scaled by half the image size, so that resolutions compare (as 3DGS does)."""
        scaled = gradient * torch.tensor([0.5 * width, 0.5 * height])
        self.total += scaled.norm(dim=1)
        self.count += visible

    def mean(self) -> Tensor:
        return self.total / self.count.clamp_min(1)


def target_count(config: DensifyConfig, initial: int, most: int, step: int, steps: int) -> int:
    """The schedule: from `initial` to `most`, fast at first (a square root in time)."""
    span = max((config.stop - config.start) * steps, 1)
    done = min(max((step - config.start * steps) / span, 0.0), 1.0)
    return int(initial + (most - initial) * done**0.5) if most > initial else initial


def is_round(config: DensifyConfig, step: int, steps: int) -> bool:
    """Whether this step ends with a round."""
    return step % config.every == 0 and config.start * steps <= step <= config.stop * steps


def densify(
    optimizer: Adam,
    gradients: ScreenGradients,
    config: DensifyConfig,
    *,
    target: int,
    extent: float,
    generator: torch.Generator,
) -> int:
    """One round: prune the faint, multiply the most wanted. Parameters and moments are replaced.

    Args:
        optimizer: of means, quats, log_scales, opacity_logits and any number of per-Gaussian others, `[N, ...]` each.
        target: how many Gaussians there should be afterwards, if enough of them have a gradient.
        extent: the scene's extent, world units.
        generator: draws where the samples of a split lie.

    Returns:
        The new N.
    """
    parameters = optimizer.parameters
    with torch.no_grad():
        faint = torch.sigmoid(parameters["opacity_logits"]) < config.prune_opacity
        # Larger than the whole scene: it hides what is behind it from every camera.
        huge = parameters["log_scales"].exp().amax(1) > extent
        keep = ~(faint | huge | ~torch.isfinite(parameters["means"]).all(1))
        wanted = torch.where(keep, gradients.mean(), torch.zeros(()))
        room = max(0, target - int(keep.sum()))
        chosen = torch.topk(wanted, min(room, int((wanted > 0).sum()))).indices
        large = parameters["log_scales"][chosen].exp().amax(1) > config.split_size * extent
        cloned, split = chosen[~large], chosen[large]

        # A split replaces the parent by two samples of it, 1.6 times smaller; a clone adds a copy.
        keep[split] = False
        sources = torch.cat([torch.nonzero(keep)[:, 0], cloned, split, split])
        n_children = 2 * len(split)
        fresh = torch.zeros(len(sources), dtype=torch.bool)
        fresh[int(keep.sum()) :] = True
        new = {name: value.detach()[sources] for name, value in parameters.items()}
        if n_children:
            scales = new["log_scales"][-n_children:].exp()
            noise = torch.randn(n_children, 3, generator=generator) * scales
            rotations = rotations_from_quats(new["quats"][-n_children:])
            new["means"][-n_children:] += (rotations @ noise[..., None])[..., 0]
            new["log_scales"][-n_children:] -= torch.log(torch.tensor(1.6))
        replace(optimizer, new, sources, fresh)
    return len(sources)


def replace(optimizer: Adam, new: dict[str, Tensor], sources: Tensor, fresh: Tensor) -> None:
    """Swap each parameter for `new[name]`, carrying Adam's moments over by `sources` `[M]` and zeroing those of `fresh` `[M]`."""
    for name, value in new.items():
        moments = [moment[name][sources] for moment in (optimizer.first, optimizer.second)]
        for moment in moments:
            moment[fresh] = 0
        optimizer.replace(name, value, *moments)
