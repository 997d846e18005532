"""The unknowns of the fit as colours of a thermal model, so that `render` and every viewer show them unclamped."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from rtgs.maths import sh
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.radiometry import LinearRange, ThermalRange, Unit, extended
from rtgs.thermal.design import Design


def affine(design: Design, x: Tensor, gain: float, offset: float) -> Tensor:
    """Unknowns `[D, C]` whose images are `gain · image + offset` of the images of x."""
    x = gain * x
    design.harmonics(x)[:, 0] += offset / sh.C0
    x[-1] += offset
    return x


def as_model(
    x: Tensor, design: Design, rgb_model: RgbModel, *, unit: Unit, scores: LinearRange, colors: ThermalRange, sfm_per_metre: float
) -> ThermalModel:
    """Unknowns `[D, 1]` as a thermal model.

    Splat renderers show max(0, ½ + basis · sh). Colour 0 is therefore put at or below the lowest value of any Gaussian in any
    direction, so that the maximum never acts. With band norms |sh_l|, a colour lies within Σ_{l ≥ 1} √((2l + 1) / 4π) · |sh_l| of its
    constant part (addition theorem of spherical harmonics).

    Args:
        unit: the model's.
        scores: the model's `range`.
        colors: the range whose units the unknowns are in.
    """
    harmonics, background = design.harmonics(x)[..., 0], float(x[-1, 0])
    lowest = sh.C0 * harmonics[:, 0]
    for l in range(1, math.isqrt(design.coefficients)):
        lowest = lowest - math.sqrt((2 * l + 1) / (4 * math.pi)) * harmonics[:, l * l : (l + 1) ** 2].norm(dim=1)
    floor = min(float(lowest.min()), background)
    floor = floor - 1e-3 if floor < 0 else 0.0  # a thousandth of the range further, for the last digits of float32
    stored = harmonics / (1.0 - floor)
    stored[:, 0] += (-floor / (1.0 - floor) - 0.5) / sh.C0
    return ThermalModel(
        gaussians=replace(rgb_model.gaussians.detach(), sh=stored[..., None].contiguous()),
        background=torch.tensor([(background - floor) / (1.0 - floor)]),
        unit=unit,
        range=scores,
        color_range=extended(colors, floor),
        settings=rgb_model.settings,
        sfm_per_metre=float(sfm_per_metre),
    )
