"""GLB with KHR_gaussian_splatting, the ratified extension of glTF 2.0: plain float accessors, y up, metres.

Temperatures are further attributes, whose names begin with `_` as glTF asks of an application's own.
Source: https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0/Khronos/KHR_gaussian_splatting
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtgs import __version__
from rtgs.base.files import write_whole
from rtgs.io.exports.subject import Splats

_EXTENSION = "KHR_gaussian_splatting"
_FLOAT, _ARRAY_BUFFER, _POINTS = 5126, 34962, 0
_KIND = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def write_glb(path: Path, splats: Splats, extras: dict[str, Any]) -> None:
    """Write a model as one primitive of points; `path` appears whole or not at all.

    Args:
        extras: facts for people and programs, such as the unit; stored with the node.
    """
    attributes = _attributes(splats)
    accessors, views, body, offset = list[dict[str, Any]](), list[dict[str, Any]](), list[bytes](), 0
    for name, values in attributes.items():
        data = np.ascontiguousarray(values, dtype="<f4")
        accessor = {"bufferView": len(views), "componentType": _FLOAT, "count": len(data), "type": _KIND[data.shape[1]]}
        if name == "POSITION":
            accessor |= {"min": data.min(axis=0).tolist(), "max": data.max(axis=0).tolist()}
        accessors.append(accessor)
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": data.nbytes, "target": _ARRAY_BUFFER})
        body.append(data.tobytes())
        offset += data.nbytes
    kernel = {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    primitive = {
        "attributes": {name: i for i, name in enumerate(attributes)},
        "mode": _POINTS,
        "extensions": {_EXTENSION: kernel},
    }
    document = {
        "asset": {"version": "2.0", "generator": f"rtgs {__version__}"},
        "extensionsUsed": [_EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": path.stem, "extras": extras}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + offset
    with write_whole(path) as temporary, temporary.open("wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, total) + struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", offset, b"BIN\0"))
        file.writelines(body)


def _attributes(splats: Splats) -> dict[str, NDArray[np.floating]]:
    found: dict[str, NDArray[np.floating]] = {
        "POSITION": splats.means,
        "COLOR_0": np.concatenate([linear_from_srgb(splats.colours), splats.opacities[:, None]], axis=1),
        f"{_EXTENSION}:ROTATION": splats.quats[:, [1, 2, 3, 0]],
        f"{_EXTENSION}:SCALE": np.exp(splats.log_scales.astype(np.float64)),
        f"{_EXTENSION}:OPACITY": splats.opacities[:, None],
    }
    for degree in range(splats.sh_degree + 1):
        for i in range(2 * degree + 1):
            found[f"{_EXTENSION}:SH_DEGREE_{degree}_COEF_{i}"] = splats.sh[:, degree**2 + i]
    return found | {f"_{name.upper()}": column[:, None] for name, column in splats.columns.items()}


def linear_from_srgb(colours: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours in [0, 1] without sRGB's curve, as `COLOR_0` holds them (IEC 61966-2-1)."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
