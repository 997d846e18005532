"""Gaussians as bytes for the page: 30 of them for each Gaussian of RGB, 29 for each thermal one."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtgs.io.exports.subject import Splats

_SMALLEST, _LARGEST = -16.0, 8.0  # ln of sizes in metres


@dataclass(frozen=True)
class Packed:
    """A model for the page.

    Attributes:
        json: what the page's script reads: the number of Gaussians, and arrays in base64 by name.
        count: Gaussians in the page.
        left_out: the faintest and smallest of the model, which the page has no room for.
    """

    json: dict[str, Any]
    count: int
    left_out: int


def pack(splats: Splats, most: int, level: NDArray[np.floating] | None) -> Packed:
    """A model's Gaussians, at most so many.

    Args:
        level: `[N]` in [0, 1], what a thermal model shows instead of colours.
    """
    kept = np.arange(len(splats))
    if len(splats) > most:
        two_largest = np.sort(splats.log_scales, axis=1)[:, 1:].sum(axis=1)  # the area that it covers
        weight = splats.opacities * np.exp(two_largest.astype(np.float64))
        kept = np.sort(np.argsort(weight)[-most:])
    size = (np.clip(splats.log_scales[kept], _SMALLEST, _LARGEST) - _SMALLEST) / (_LARGEST - _SMALLEST)
    arrays: dict[str, NDArray] = {
        "means": splats.means[kept].astype("<f4"),
        "sizes": np.rint(size * 65535).astype("<u2"),
        "quats": np.rint(splats.quats[kept] * 32767).astype("<i2"),
        "alphas": np.rint(splats.opacities[kept] * 255).astype("u1"),
    }
    if level is None:
        arrays["colours"] = np.rint(splats.colours[kept] * 255).astype("u1")
    else:
        arrays["levels"] = np.rint(np.clip(level[kept], 0.0, 1.0) * 65535).astype("<u2")
    text = {name: base64.b64encode(array.tobytes()).decode("ascii") for name, array in arrays.items()}
    return Packed({"count": len(kept), "smallest": _SMALLEST, "largest": _LARGEST, **text}, len(kept), len(splats) - len(kept))
