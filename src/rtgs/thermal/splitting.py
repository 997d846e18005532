"""Gaussians split into two along their longest axis, so that thermal colours can change within what one RGB colour covers."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from rtgs.maths.quaternions import rotations_from_quats
from rtgs.records.gaussians import Gaussians

SHIFT = 0.85
"""Distance of a child from its parent's centre, in standard deviations of the parent along the axis. The children's own deviation follows:
√(1 − shift²), about half. Chosen by the error of held-out synthetic views with as many Gaussians: at 0.8 more splits are needed for small
things, at 0.9 the pair has a dip in the middle."""
OPACITY = 0.875
"""Opacity of a child as a share of its parent's. With it the pair's composited alpha is closest to the parent's in the mean square; the
best share lies between 0.874 and 0.878 at any opacity. A pair is still 36 to 38 % (root mean square) off its parent."""


def split(gaussians: Gaussians, which: Tensor) -> tuple[Gaussians, Tensor]:
    """Replace some Gaussians by two children each. The pair has its parent's mean and covariance, and its colours.

    Args:
        which: `[S]`, indices of the parents.

    Returns:
        N + S Gaussians, those that are not split first and then the children; and the parent of each, its own index for the former.
    """
    n, count = len(gaussians), len(which)
    stays = torch.ones(n, dtype=torch.bool)
    stays[which] = False
    parents = torch.cat([torch.nonzero(stays)[:, 0], which, which])
    first = n - count
    tensors = {name: value.detach()[parents] for name, value in gaussians.tensors().items()}

    rows, axis = torch.arange(count), gaussians.log_scales[which].argmax(dim=1)
    rotations = rotations_from_quats(gaussians.quats[which])
    shift = SHIFT * gaussians.log_scales[which, axis].exp()[:, None] * rotations[rows, :, axis]
    tensors["means"][first:] += torch.cat([shift, -shift])
    tensors["log_scales"][first + torch.arange(2 * count), axis.repeat(2)] += 0.5 * math.log(1.0 - SHIFT**2)
    tensors["opacity_logits"][first:] = torch.logit(OPACITY * torch.sigmoid(tensors["opacity_logits"][first:]))
    return Gaussians(**tensors), parents
