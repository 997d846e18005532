"""Mutual information as registration packages take it: Mattes et al., "PET-CT image registration in the chest using free-form
deformations" (2003), with the choices of ITK's metric of that name.

The joint histogram of the thermal image (fixed) and the render (moving) has 50 × 50 bins, two of them at each end as padding. The fixed
image falls into one bin (it does not move, so its window need not be smooth), the moving one into four, by a cubic B-spline:

    p(f, m) = 1/N Σ_x [bin(B(x)) = f] β³(m − u(x)),   u = 2 + 46 · A(x),
    MI = Σ p ln(p / (p_f p_m)),   dMI = Σ_x −β³′(m − u) u̇ ln(p / p_m) / N

(the other terms sum to zero, as Σ dp does). ITK takes the moving image's range from the image before it moves; a render's is [0, 1].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtgs.base.compiled import inlined, kernel
from rtgs.experiments.rivals.losses import Rival

_BINS = 50
_PADDING = 2
_INNER = _BINS - 2 * _PADDING


class MutualInformation:
    """−MI of the render and the thermal image over the valid pixels, in nats."""

    def __init__(self, thermal: NDArray[np.float32], mask: NDArray[np.bool_]) -> None:
        self._mask = None if mask.all() else mask
        values = thermal[mask].astype(np.float64)
        lo, hi = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
        at = _PADDING + _INNER * (values - lo) / (hi - lo if hi > lo else 1.0)
        self._fixed = np.clip(at.astype(np.int64), _PADDING, _BINS - _PADDING - 1)

    def __call__(self, gray: NDArray[np.float32], tangent: NDArray[np.float32]) -> tuple[float, float]:
        moving, rate = (a.ravel() if self._mask is None else a[self._mask] for a in (gray, tangent))
        joint = _joint(self._fixed, moving)
        total = joint.sum()
        if total == 0.0:
            return 0.0, 0.0
        joint /= total
        of_fixed, of_moving = joint.sum(axis=1), joint.sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            information = np.where(joint > 0, joint * np.log(joint / (of_fixed[:, None] * of_moving)), 0.0).sum()
            gains = np.where(joint > 0, np.log(joint / of_moving), 0.0)
        return -float(information), -float(_slope(self._fixed, moving, rate, gains)) / total


@inlined
def _position(value):  # type: ignore[no-untyped-def]
    """u, and whether the value lies inside of [0, 1]."""
    inside = 0.0 < value < 1.0
    return _PADDING + _INNER * min(max(float(value), 0.0), 1.0), inside


@kernel(checks_division=True)
def _joint(fixed, moving):  # type: ignore[no-untyped-def]
    """`[bins, bins]`: sums of β³(m − u) over the pixels of each fixed bin."""
    joint = np.zeros((_BINS, _BINS))
    for i in range(len(fixed)):
        u, _ = _position(moving[i])
        first = int(u) - 1
        t = u - int(u)
        row = joint[fixed[i]]
        row[first] += (1.0 - t) ** 3 / 6.0
        row[first + 1] += (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
        row[first + 2] += (1.0 + 3.0 * t + 3.0 * t * t - 3.0 * t * t * t) / 6.0
        row[first + 3] += t * t * t / 6.0
    return joint


@kernel(checks_division=True)
def _slope(fixed, moving, rate, gains):  # type: ignore[no-untyped-def]
    """Σ over pixels and bins of gains · dβ³(m − u)/du · u̇."""
    total = 0.0
    for i in range(len(fixed)):
        u, inside = _position(moving[i])
        if inside:
            first = int(u) - 1
            t = u - int(u)
            row = gains[fixed[i]]
            total += (
                rate[i]
                * _INNER
                * (
                    -0.5 * (1.0 - t) ** 2 * row[first]
                    + (1.5 * t * t - 2.0 * t) * row[first + 1]
                    + (0.5 + t - 1.5 * t * t) * row[first + 2]
                    + 0.5 * t * t * row[first + 3]
                )
            )
    return total


MUTUAL_INFORMATION = Rival("mutual_information", "mutual information (Mattes)", MutualInformation, smooth_px=0.25)
