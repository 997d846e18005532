"""3D Gaussian models as PLY files, in the field layout of INRIA's 3DGS, which every splat viewer reads.

One vertex a Gaussian: `x y z`, `nx ny nz` (zero), `f_dc_0…2`, `f_rest_0…3(K−1)−1`, `opacity` (logit), `scale_0…2` (ln),
`rot_0…3` (wxyz). `f_rest` runs channel by channel: all K − 1 coefficients of red, then green, then blue.

A thermal model has one channel. Viewers expect three, so it is written three times over (they show it gray), with properties of
floats beside it that viewers pass over (`temperature`, °C; `temperature_std`, its standard error; `views`, how many see the Gaussian)
and comments from which reading takes it back to exactly one channel.

INRIA's layout has no place for the colour behind the Gaussians. An RGB model of ours says it in a comment, and viewers pass over it.

A file holds the frame that the poses were given in. `x y z` are floats, as all viewers expect, and doubles where the frame's origin is
so far away that floats would move the Gaussians. INRIA's Python code, plyfile and CloudCompare read doubles. A viewer that does not
could show nothing sensible of such coordinates in floats either.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement
from torch import Tensor

from rtgs.base.errors import RtgsError
from rtgs.base.files import reason, write_whole
from rtgs.maths.geometry import Sim3
from rtgs.maths.sh import C0
from rtgs.records.gaussians import Gaussians
from rtgs.records.world import is_far

THERMAL_PROPERTIES = ("temperature", "temperature_std", "views")
_THERMAL = "rtgs thermal"
_RANGE = "rtgs celsius_range"
_BACKGROUND = "rtgs background"
_LONGEST_HEADER = 1 << 16  # bytes
_DEGREE_OF_REST = {0: 0, 9: 1, 24: 2, 45: 3}


@dataclass(frozen=True, eq=False)
class ThermalPly:
    """A thermal model and the temperatures that colours 0 and 1 stand for, °C; None where the capture had no radiometry.

    `properties` are the float properties beside it, `[N]` each.
    """

    gaussians: Gaussians
    celsius_range: tuple[float, float] | None
    properties: Mapping[str, NDArray[np.float32]]


def write_ply(
    path: Path,
    gaussians: Gaussians,
    *,
    given_from_world: Sim3 | None = None,
    celsius_range: tuple[float, float] | None = None,
    properties: Mapping[str, NDArray[np.float32]] | None = None,
    background: Sequence[float] | None = None,
) -> None:
    """Write a model as binary little-endian floats; `path` appears whole or not at all.

    Args:
        path: its folder must exist.
        gaussians: three channels, or one: a thermal model.
        given_from_world: leads from the model's world to the frame of the file (`Scene.given_from_world`); it does not turn. Positions are
            computed in float64, and written as doubles where the file's origin is far away. None: the file holds the model's world.
        celsius_range: °C at colour 0 and at colour 1, for thermal models only. Adds the property `temperature`, °C: the colour
            without its view-dependent part, max(0, ½ + C0 · dc), mapped linearly, unless `properties` has a better one.
        properties: names in `THERMAL_PROPERTIES` and `[N]` each, for thermal models only.
        background: `[3]` in [0, 1], the colour behind an RGB model, for `read_background`.

    Raises:
        RtgsError: the model holds NaN or infinity, or the file cannot be written.
        ValueError: neither one nor three channels, or a range or properties for a model that is not thermal, or another name.
    """
    path = Path(path)
    thermal = gaussians.channels == 1
    if gaussians.channels not in (1, 3):
        raise ValueError(f"a PLY holds 3 channels, or 1 for a thermal model; got {gaussians.channels}")
    if celsius_range is not None and not thermal:
        raise ValueError("celsius_range is for a thermal model, of one channel")
    properties = properties or {}
    if not (thermal or not properties) or not set(properties) <= set(THERMAL_PROPERTIES):
        raise ValueError(f"properties are {', '.join(THERMAL_PROPERTIES)}, of a thermal model; got {', '.join(properties)}")
    given = _unturned(given_from_world)
    arrays = {name: _numpy(t) for name, t in gaussians.tensors().items()} | dict(properties)
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise RtgsError(f"{path}: not written, the model's {name} holds NaN or infinity")
    sh = np.repeat(arrays["sh"], 3, axis=2) if thermal else arrays["sh"]
    count, coefficients, _ = sh.shape
    columns: dict[str, NDArray[np.floating]] = {}
    columns |= _columns("xyz", _positions(arrays["means"], given))
    columns |= _columns(("nx", "ny", "nz"), np.zeros((count, 3), np.float32))
    columns |= _columns("f_dc", sh[:, 0])
    columns |= _columns("f_rest", sh[:, 1:].transpose(0, 2, 1).reshape(count, 3 * (coefficients - 1)))
    columns["opacity"] = arrays["opacity_logits"]
    columns |= _columns("scale", arrays["log_scales"] + np.float32(math.log(given.factor)))
    columns |= _columns("rot", arrays["quats"])
    comments = [_THERMAL] if thermal else []
    if background is not None:
        comments.append(" ".join([_BACKGROUND, *(repr(float(v)) for v in background)]))
    if celsius_range is not None:
        lo, hi = (float(v) for v in celsius_range)
        comments.append(f"{_RANGE} {lo!r} {hi!r}")
        columns["temperature"] = (lo + (hi - lo) * np.maximum(0.0, 0.5 + C0 * sh[:, 0, 0].astype(np.float64))).astype(np.float32)
    columns |= properties
    vertices = np.empty(count, dtype=[(name, "<f8" if c.dtype == np.float64 else "<f4") for name, c in columns.items()])
    for name, column in columns.items():
        vertices[name] = column
    ply = PlyData([PlyElement.describe(vertices, "vertex")], text=False, byte_order="<", comments=comments)
    try:
        with write_whole(path) as temporary:
            ply.write(str(temporary))
    except OSError as error:
        raise RtgsError(f"{path}: cannot be written: {reason(error)}") from error


def _unturned(given_from_world: Sim3 | None) -> Sim3:
    given = Sim3.identity() if given_from_world is None else given_from_world
    if (given.rotation != np.eye(3)).any():
        raise ValueError("given_from_world turns the model; the harmonics would have to be turned too")
    return given


def _positions(means: NDArray[np.float32], given_from_world: Sim3) -> NDArray[np.floating]:
    """`[N, 3]` in the given frame: float64 where its origin is far away, else float32."""
    if given_from_world.factor == 1.0 and not given_from_world.translation.any():
        return means
    positions = given_from_world.apply(means.astype(np.float64))
    return positions if is_far(given_from_world) else positions.astype(np.float32)


def read_ply(path: Path, given_from_world: Sim3 | None = None) -> Gaussians:
    """Read a model: ours, or anyone's in INRIA's layout.

    ASCII or binary, any precision and order of properties; extra ones are ignored, normals are not needed.

    Args:
        given_from_world: leads from the world that the model is wanted in to the frame of the file; it does not turn. Positions are brought
            over in float64. None: that frame is the world.

    Returns:
        float32 tensors; `sh` `[N, K, 1]` where the file says that it is a thermal model of ours, else `[N, K, 3]`.

    Raises:
        RtgsError: the file is missing, no PLY, cut short, lacks a field, or a field holds NaN or infinity; it names both.
    """
    return _read(Path(path), given_from_world)[0]


def read_background(path: Path) -> tuple[float, float, float] | None:
    """The colour in [0, 1] behind an RGB model, where its file states one, as files of `write_ply` do. `read_ply` has accepted the file.

    Raises:
        RtgsError: the comment does not hold three numbers from 0 to 1.
    """
    for comment in PlyData.read(str(path)).comments:
        if comment.startswith(_BACKGROUND):
            try:
                red, green, blue = (float(v) for v in comment[len(_BACKGROUND) :].split())
            except ValueError:
                red = green = blue = math.nan
            if not all(0.0 <= v <= 1.0 for v in (red, green, blue)):
                raise RtgsError(f"{path}: unreadable comment '{comment:.100}' (expected three numbers from 0 to 1)")
            return red, green, blue
    return None


def read_thermal_ply(path: Path, given_from_world: Sim3 | None = None) -> ThermalPly:
    """Read a thermal model that `write_ply` wrote; `given_from_world` as for `read_ply`.

    Raises:
        RtgsError: as `read_ply`, or the file is not a thermal model.
    """
    gaussians, comments, properties = _read(Path(path), given_from_world)
    if gaussians.channels != 1:
        raise RtgsError(f"{path}: not a thermal model (no comment '{_THERMAL}' in its header)")
    for comment in comments:
        if comment.startswith(_RANGE):
            try:
                lo, hi = (float(v) for v in comment[len(_RANGE) :].split())
            except ValueError:
                lo = hi = math.nan
            if not -math.inf < lo < hi < math.inf:
                raise RtgsError(f"{path}: unreadable comment '{comment:.100}' (expected two temperatures, the lower one first)")
            return ThermalPly(gaussians, (lo, hi), properties)
    return ThermalPly(gaussians, None, properties)


def _read(path: Path, given_from_world: Sim3 | None) -> tuple[Gaussians, list[str], dict[str, NDArray[np.float32]]]:
    try:
        check_length(path)
        ply = PlyData.read(str(path))
    except RtgsError:
        raise
    except OSError as error:
        raise RtgsError(f"{path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:  # plyfile has an error of its own, and raises others where a header says odd things
        raise RtgsError(f"{path}: not a whole PLY file ({error!s:.200})") from error
    if "vertex" not in ply:
        raise RtgsError(f"{path}: a PLY without 'vertex' elements; not a Gaussian model")
    data = ply["vertex"].data
    if len(data) == 0:
        raise RtgsError(f"{path}: holds no Gaussians")
    if "filter_3D" in data.dtype.names:
        raise RtgsError(
            f"{path}: has the property filter_3D of Mip-Splatting, which changes opacities and sizes when a model is drawn. Merge it into "
            "them with that project's create_fused_ply.py."
        )
    names = set(data.dtype.names or ())

    def stacked(*fields: str) -> NDArray[np.float32]:
        return np.stack([_field(path, data, names, f) for f in fields], axis=1)

    given = _unturned(given_from_world)
    positions = np.stack([_field(path, data, names, f, np.float64) for f in "xyz"], axis=1)
    dc = stacked("f_dc_0", "f_dc_1", "f_dc_2")
    rest_count = sum(name.startswith("f_rest_") for name in names)
    if rest_count not in _DEGREE_OF_REST:
        raise RtgsError(f"{path}: {rest_count} f_rest fields; SH degree 0–3 has one of {sorted(_DEGREE_OF_REST)}")
    sh = dc[:, None, :]
    if rest_count:
        rest = stacked(*(f"f_rest_{i}" for i in range(rest_count))).reshape(len(data), 3, rest_count // 3)
        sh = np.concatenate([sh, rest.transpose(0, 2, 1)], axis=1)
    if _THERMAL in ply.comments:
        sh = sh[:, :, :1]
    with np.errstate(over="ignore"):
        means = given.apply_inverse(positions).astype(np.float32)
    if not np.isfinite(means).all():
        raise RtgsError(f"{path}: fields x, y and z hold a position that is too far away for float32")
    quats = stacked("rot_0", "rot_1", "rot_2", "rot_3")
    if (np.abs(quats).max(axis=1) == 0).any():
        raise RtgsError(f"{path}: fields rot_0 … rot_3 hold a quaternion of length zero")
    gaussians = Gaussians(
        means=torch.from_numpy(means),
        quats=torch.from_numpy(quats),
        log_scales=torch.from_numpy(stacked("scale_0", "scale_1", "scale_2") - np.float32(math.log(given.factor))),
        opacity_logits=torch.from_numpy(_field(path, data, names, "opacity")),
        sh=torch.from_numpy(np.ascontiguousarray(sh)),
    )
    properties = {p: _field(path, data, names, p) for p in THERMAL_PROPERTIES if p in names and _THERMAL in ply.comments}
    return gaussians, list(ply.comments), properties


def check_length(path: Path) -> None:
    """Refuse a header that announces more numbers than the file has bytes, before memory is taken for them."""
    with path.open("rb") as file:
        header = file.read(_LONGEST_HEADER).partition(b"end_header")[0].decode("ascii", "replace")
    size, counts = path.stat().st_size, list[list[int]]()
    for words in map(str.split, header.splitlines()):
        if words[:1] == ["element"] and len(words) == 3 and words[2].isdecimal():
            counts.append([int(words[2][:30]), 0])
        elif words[:1] == ["property"] and counts:
            counts[-1][1] += 1
    announced = sum(elements * max(1, properties) for elements, properties in counts)
    if announced > size:
        raise RtgsError(f"{path}: not a whole PLY file (its header announces {announced:,} numbers, and it has {size:,} bytes)")


def _field(
    path: Path, data: NDArray[np.void], names: set[str], field: str, dtype: type[np.floating] = np.float32
) -> NDArray[Any]:
    if field not in names:
        raise RtgsError(f"{path}: field '{field}' is missing; not a 3D Gaussian model in INRIA's layout")
    if data[field].dtype == object:
        raise RtgsError(f"{path}: field '{field}' is a list, a number is needed")
    with np.errstate(over="ignore"):  # a double beyond float32 becomes infinite and is reported as such
        column = np.array(data[field], dtype=dtype)  # a copy: plyfile maps the file, which may be replaced later
    bad = np.count_nonzero(~np.isfinite(column))
    if bad:
        raise RtgsError(f"{path}: field '{field}' is NaN or infinite in {bad} of {len(column)} Gaussians")
    return column


def _columns(name: str | tuple[str, ...], array: NDArray[np.floating]) -> dict[str, NDArray[np.floating]]:
    """Columns of `[N, n]` under `name_0 … name_(n−1)`, under the letters of "xyz", or under the names given."""
    width = array.shape[1]
    names = tuple(name) if name == "xyz" or isinstance(name, tuple) else tuple(f"{name}_{i}" for i in range(width))
    return {n: array[:, i] for i, n in enumerate(names)}


def _numpy(tensor: Tensor) -> NDArray[np.float32]:
    return tensor.detach().cpu().to(torch.float32).numpy()
