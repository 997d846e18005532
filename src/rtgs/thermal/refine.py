"""Geometry that is fitted to the thermal images: a few hundred steps of Adam on all that Gaussians have, one photograph each.

The RGB model's edges and depths suit the RGB photographs, at the RGB camera's poses. Where they are off, one place of the surface is shown
in another place of each thermal image, and no colour suits them all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rtgs.maths import sh
from rtgs.maths.adam import Adam
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import RenderSettings, render
from rtgs.thermal.design import Design
from rtgs.thermal.drift import Drift
from rtgs.thermal.fit import Fit

# Learning rates at the start: about those in the middle of a training of the RGB model (`rtgs.rgb.schedule`). They fall to a twentieth.
RATES = {"quats": 2e-3, "log_scales": 1e-2, "opacity_logits": 5e-2, "sh": 2.5e-3}
RATE_OF_MEANS = 6.4e-5  # of the scene's extent
SETTLE_TO = 0.05
# The renderer clamps colours at 0. It is given how much more than this they are, in units of the range; none is less.
LOWEST = -30.0


@dataclass(frozen=True, eq=False)
class Geometry:
    """Gaussians, and how a design is made of them.

    Attributes:
        camera: of whole photographs.
        every: the fit uses one row in so many.
        extent: of the scene, world units.
        moves: whether Gaussians are fitted (`refined`) before they are split.
        design: makes the design of other Gaussians.
    """

    gaussians: Gaussians
    camera: Camera
    every: int
    extent: float
    moves: bool
    settings: RenderSettings
    design: Callable[[Gaussians], Design]


def refined(fit: Fit, geometry: Geometry, x: Tensor, drift: Drift, frames: Sequence[int]) -> tuple[Gaussians, Tensor]:
    """Gaussians that are moved, turned, scaled and made more or less opaque, by ℓ1 on some of the photographs.

    Its median keeps out what few photographs show. The RGB photographs have no part in it: as an anchor they double the time and change
    the error of held-out thermal images by less than a hundredth.

    Args:
        fit: with the design of the geometry's Gaussians.
        x: `[D, 1]`, the unknowns to start from.
        drift: of all frames.

    Returns:
        Gaussians with the same colours as before, and unknowns that suit them.
    """
    steps, data, gaussians = fit.settings.follow.steps, fit.data, geometry.gaussians
    rates, rows = {**RATES, "means": RATE_OF_MEANS * geometry.extent}, slice(geometry.every // 2, None, geometry.every)
    colors = fit.design.harmonics(x).clone()
    colors[:, 0] -= (0.5 + LOWEST) / sh.C0
    own = {name: value.clone() for name, value in gaussians.geometry._asdict().items()}  # the optimizer changes them in place
    optimizer = Adam({**own, "sh": colors}, {})
    generator, order = torch.Generator().manual_seed(0), list[int]()
    count, background = data.valid.sum(), x[-1]
    for step in range(steps):
        order = order or torch.randperm(len(frames), generator=generator).tolist()
        frame = frames[order.pop()]
        settling = SETTLE_TO ** (step / steps)
        optimizer.rates = {name: rate * settling for name, rate in rates.items()}
        view = render(Gaussians(**optimizer.parameters), geometry.camera, data.poses[frame], settings=geometry.settings)
        image = (view.color[..., 0] + view.alpha * LOWEST + (1.0 - view.alpha) * background)[rows]
        ((data.images[frame] - drift.of(frame, image)).abs() * data.valid).sum().div(count).backward()
        optimizer.step()
        fit.each()
    tensors = {name: value.detach() for name, value in optimizer.parameters.items()}
    colors = tensors.pop("sh").clone()
    colors[:, 0] += (0.5 + LOWEST) / sh.C0
    return Gaussians(**tensors, sh=gaussians.sh), torch.cat([colors.flatten(0, 1), background[None]])
