"""Compressed PLY, as PlayCanvas and SuperSplat read it: 16 bytes a Gaussian, and a byte for each higher harmonic.

Gaussians stand in chunks of 256 neighbours; each chunk has the limits between which its numbers are quantised.
Source: https://github.com/playcanvas/splat-transform
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtgs.base.files import write_whole
from rtgs.io.exports.subject import Splats
from rtgs.maths.sh import C0

_CHUNK = 256
_SMALLEST, _LARGEST = -20.0, 20.0  # ln of sizes


def write_compressed_ply(path: Path, splats: Splats) -> None:
    """Write a model, its Gaussians in a new order: neighbours stand together. `path` appears whole or not at all."""
    order = morton_order(splats.means)
    chunk_of = np.arange(len(order)) // _CHUNK
    limits, packed = [], {}
    for name, values, bits in (
        ("position", splats.means[order], (11, 10, 11)),
        ("scale", np.clip(splats.log_scales[order], _SMALLEST, _LARGEST).astype(np.float64), (11, 10, 11)),
        ("color", 0.5 + C0 * splats.sh[order, 0].astype(np.float64), (8, 8, 8)),
    ):
        lo, hi = _limits(values)
        limits += [lo, hi]
        # A reader takes the limits from the file, so they are rounded as the file has them before they are used.
        level = (values - lo[chunk_of]) / np.maximum(hi - lo, 1e-30)[chunk_of]
        packed[name] = _pack(level, bits)
    colour = (packed["color"] << np.uint32(8)) | _quantised(splats.opacities[order], 8)
    vertices = np.stack([packed["position"], _packed_rotations(splats.quats[order]), packed["scale"], colour], axis=1)
    rest = splats.sh[order, 1:].transpose(0, 2, 1).reshape(len(order), -1)
    harmonics = np.clip(np.rint((rest / 8.0 + 0.5) * 255.0), 0, 255).astype(np.uint8)
    with write_whole(path) as temporary, temporary.open("wb") as file:
        file.write(_header(int(chunk_of[-1]) + 1, len(order), harmonics.shape[1]))
        file.write(np.concatenate(limits, axis=1).astype("<f4").tobytes())
        file.write(vertices.astype("<u4").tobytes())
        file.write(harmonics.tobytes())


def morton_order(means: NDArray[np.float64]) -> NDArray[np.int64]:
    """`[N]`: an order in which neighbours in space are mostly neighbours."""
    lo, hi = means.min(axis=0), means.max(axis=0)
    cells = ((means - lo) / np.maximum(hi - lo, 1e-30) * 1023).astype(np.uint64)
    code = np.zeros(len(means), np.uint64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")


def _limits(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Least and largest of each chunk `[chunks, 3]`, as float32 holds them."""
    starts = np.arange(0, len(values), _CHUNK)
    found = (of.reduceat(values, starts, axis=0).astype(np.float32).astype(np.float64) for of in (np.minimum, np.maximum))
    lo, hi = found
    return lo, hi


def _quantised(level: NDArray[np.float64], bits: int) -> NDArray[np.uint32]:
    top = (1 << bits) - 1
    return np.clip(np.rint(level * top), 0, top).astype(np.uint32)


def _pack(level: NDArray[np.float64], bits: tuple[int, int, int]) -> NDArray[np.uint32]:
    packed = np.zeros(len(level), np.uint32)
    for axis, width in enumerate(bits):
        packed = (packed << np.uint32(width)) | _quantised(level[:, axis], width)
    return packed


def _packed_rotations(wxyz: NDArray[np.float64]) -> NDArray[np.uint32]:
    """`[N]`: which component is largest (2 bits), and 10 bits of each other one; the largest is above 0."""
    rows, largest = np.arange(len(wxyz)), np.abs(wxyz).argmax(axis=1)
    positive = wxyz * np.where(wxyz[rows, largest] < 0, -1.0, 1.0)[:, None]
    parts = _quantised(positive * math.sqrt(0.5) + 0.5, 10)
    packed = largest.astype(np.uint32)
    for axis in range(4):
        packed = np.where(largest == axis, packed, (packed << np.uint32(10)) | parts[:, axis])
    return packed


def _header(chunks: int, count: int, harmonics: int) -> bytes:
    limits = [f"property float {end}_{n}" for names in (("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b"))
              for end in ("min", "max") for n in names]  # fmt: skip
    words = [f"property uint packed_{name}" for name in ("position", "rotation", "scale", "color")]
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {chunks}", *limits, f"element vertex {count}", *words]
    if harmonics:
        lines += [f"element sh {count}", *(f"property uchar f_rest_{i}" for i in range(harmonics))]
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")
