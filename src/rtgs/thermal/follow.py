"""Geometry that follows the thermal images: Gaussians are split where photographs show more than the RGB model's geometry can.

A photograph cannot be shown more finely than the Gaussians are. On a plain wall RGB needs none smaller than a hand, and a loose contact is
smaller. What is missing there is in the residuals, at the same place of the surface in all photographs that see it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.thermal.design import Design
from rtgs.thermal.frames import ThermalFrames
from rtgs.thermal.settings import FollowSettings
from rtgs.thermal.splitting import split
from rtgs.thermal.surface import Footprints, Surface


@dataclass(frozen=True, eq=False)
class Finer:
    """A finer geometry.

    Attributes:
        gaussians: at most `FollowSettings.times` as many as before.
        parents: `[N]`, the Gaussian before that each is a part of.
        missing: `[h, w]` for each frame: size of the residuals that other photographs agree about, 0 elsewhere; of mean 1.
        agreed: share of the new Gaussians that lie where photographs agree about what is missing.
    """

    gaussians: Gaussians
    parents: Tensor
    missing: Sequence[Tensor]
    agreed: float


def finer_gaussians(
    design: Design,
    gaussians: Gaussians,
    data: ThermalFrames,
    camera: Camera,
    surface: Surface,
    residuals: Sequence[Tensor],
    settings: FollowSettings,
    each: Callable[[], None] = lambda: None,
) -> Finer:
    """Split Gaussians while there is room, those first that cover most pixels times what is missing in them.

    Args:
        design: of the Gaussians.
        camera: of whole photographs.
        surface: of the photographs as they are fitted.
        residuals: `[h, w]` for each frame, in units of the range.
        each: called after each frame.
    """
    missing = np.abs(surface.consensus(residuals))
    missing /= max(float(missing.mean()), 1e-12)
    footprints = Footprints(surface, missing)
    pixels, px_per_unit = _seen_sizes(design, gaussians, data, camera, each)
    most, before = int(settings.times * len(gaussians)), len(gaussians)
    parents, detail = torch.arange(before), footprints.means(gaussians)
    while len(gaussians) < most:
        sizes = gaussians.log_scales.exp().amax(dim=1) * px_per_unit
        can = (sizes > settings.finest_px) & (pixels > settings.seen_px)
        wanted = torch.where(can, pixels * (1.0 + settings.detail * detail), torch.zeros(()))
        room = min(most - len(gaussians), int(can.sum()))
        if room == 0:
            break
        # Only those near the top at once: children of the first may be wanted more than the last.
        best = wanted.topk(room).values
        least = max(float(best[0]) / 3.0, float(best[-1]))
        which = torch.nonzero(wanted >= least)[:room, 0]
        gaussians, origin = split(gaussians, which)
        kept = len(gaussians) - 2 * len(which)
        parents, pixels, px_per_unit = parents[origin], pixels[origin], px_per_unit[origin]
        pixels[kept:] *= 0.5
        children = Gaussians(**{name: value[kept:] for name, value in gaussians.tensors().items()})
        detail = torch.cat([detail[origin[:kept]], footprints.means(children)])
    parts = torch.bincount(parents, minlength=before)[parents] > 1
    agreed = float((detail[parts] > 1.0).float().mean()) if bool(parts.any()) else 0.0
    return Finer(gaussians, parents, list(torch.from_numpy(missing)), agreed)


def _seen_sizes(
    design: Design, gaussians: Gaussians, data: ThermalFrames, camera: Camera, each: Callable[[], None]
) -> tuple[Tensor, Tensor]:
    """`[N]` pixels that each Gaussian covers, and `[N]` how many pixels a unit of length is there, in the mean over them."""
    pixels, lengths = torch.zeros(len(gaussians)), torch.zeros(len(gaussians))
    means = gaussians.means.numpy().astype(np.float64)
    for f, pose in enumerate(data.poses):
        covered = design.weights(f, data.valid[..., None].contiguous())[0][:, 0]
        depth = torch.from_numpy((means @ pose.rotation.T + pose.translation)[:, 2]).float()
        pixels += covered
        lengths += torch.where(covered > 0, covered * camera.fl_x / depth.clamp_min(1e-6), torch.zeros(()))
        each()
    return pixels, lengths / pixels.clamp_min(1e-6)
