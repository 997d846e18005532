"""SPZ, Niantic's compressed Gaussians (version 3: a gzip stream of sections).

Positions are fixed-point numbers of 24 bits; colours, opacities and sizes have 8 bits, rotations 32, harmonics 8 bits a number.
The specification has y up. Programs that load a file of y down and turn it exist as well; `AXES_OF` names both kinds.
Source: https://github.com/nianticlabs/spz
"""

from __future__ import annotations

import gzip
import math
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtgs.base.files import write_whole
from rtgs.io.exports.subject import Splats

_MAGIC, _VERSION, _ANTIALIASED = 0x5053474E, 3, 0x1
_COLOUR = 0.15  # colours are stored as harmonics times this, about the middle
_FINEST_BITS = 20


def write_spz(path: Path, splats: Splats) -> None:
    """Write a model; `path` appears whole or not at all."""
    bits = fractional_bits(splats.means)
    fixed = np.rint(splats.means * 2.0**bits).astype("<i4")
    head = struct.pack("<IIIBBBB", _MAGIC, _VERSION, len(splats), splats.sh_degree, bits, _ANTIALIASED * splats.antialiased, 0)
    body = [
        np.ascontiguousarray(fixed[:, :, None].view(np.uint8)[:, :, :3]).tobytes(),
        _bytes(255.0 * splats.opacities),
        _bytes(splats.sh[:, 0] * (255.0 * _COLOUR) + 127.5),
        _bytes((splats.log_scales + 10.0) * 16.0),
        _packed_rotations(splats.quats[:, [1, 2, 3, 0]]).astype("<u4").tobytes(),
        _bytes(splats.sh[:, 1:] * 128.0 + 128.0),
    ]
    with write_whole(path) as temporary:
        temporary.write_bytes(gzip.compress(head + b"".join(body), compresslevel=6, mtime=0))


def fractional_bits(means: NDArray[np.float64]) -> int:
    """How many of the 24 bits of a position are behind the point: as many as the model's size leaves."""
    largest = float(np.abs(means).max(initial=1e-6))
    return max(1, min(_FINEST_BITS, math.floor(23 - math.log2(largest * 1.001))))


def _bytes(values: NDArray[np.floating]) -> bytes:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8).tobytes()


def _packed_rotations(xyzw: NDArray[np.float64]) -> NDArray[np.uint32]:
    """`[N]`: which component is largest (2 bits), and of each other one its sign and 9 bits; the largest is above 0."""
    rows, largest = np.arange(len(xyzw)), np.abs(xyzw).argmax(axis=1)
    positive = xyzw * np.where(xyzw[rows, largest] < 0, -1.0, 1.0)[:, None]
    size = np.minimum(np.rint(511 * np.abs(positive) * math.sqrt(2.0)), 511).astype(np.uint32)
    parts = size | ((positive < 0).astype(np.uint32) << 9)
    packed = np.zeros(len(xyzw), np.uint32)
    for axis in range(4):
        packed = np.where(largest == axis, packed, (packed << np.uint32(10)) | parts[:, axis])
    return packed | (largest.astype(np.uint32) << np.uint32(30))
