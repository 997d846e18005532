"""What changes in the course of training: learning rates, bands of the spherical harmonics, size of the images."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from rtgs.maths import sh

# The rates of 3DGS (Kerbl et al. 2023) are meant for so many steps. In fewer steps they have to be larger: with the square root of the
# ratio a random walk reaches as far. Sizes need it most.
RATES_STEPS = 30_000
MOST_PACE = 8.0
# From this share of the steps on, all rates fall to this share.
SETTLE_FROM, SETTLE_TO = 0.7, 0.05
LEAST_SIDE_PX = 48  # images are not reduced below this


def learning_rates(step: int, steps: int, extent: float, band: int) -> dict[str, float | Tensor]:
    """Learning rate of each tensor of `Gaussians`.

    Args:
        extent: of the scene, world units; positions move in proportion to it.
        band: highest one that is switched on; the bands above the first have a twentieth of its rate.
    """
    progress = step / steps
    pace = min(max(math.sqrt(RATES_STEPS / steps), 1.0), MOST_PACE)
    # Each step sees one view and is noisy. Early on, the noise finds better places; at the end it is averaged away.
    settling = max(progress - SETTLE_FROM, 0.0) / (1.0 - SETTLE_FROM)
    rate = pace * SETTLE_TO**settling
    harmonics = torch.full((sh.coefficients(band), 1), rate * 2.5e-3 / 20)
    harmonics[0] = rate * 2.5e-3
    return {
        "means": pace * 1.6e-4 * extent * 0.01**progress,
        "quats": rate * 1e-3,
        "log_scales": rate * 5e-3,
        "opacity_logits": rate * 5e-2,
        "sh": harmonics,
    }


def active_band(step: int, steps: int, sh_degree: int) -> int:
    """Highest band that is switched on: all of them from half of the steps on, evenly before."""
    return min(sh_degree, int(step / steps * 2 * (sh_degree + 1)))


def reduction(coarse_to_fine: Sequence[tuple[float, int]], step: int, steps: int, least_side: int) -> int:
    """How many times smaller than full size this step's image is.

    Args:
        coarse_to_fine: (until this share of the steps, factor); factors that make the image too small are skipped.
        least_side: of the full image, pixels.
    """
    for until, factor in coarse_to_fine:
        if step < until * steps and least_side // factor >= LEAST_SIDE_PX:
            return factor
    return 1
