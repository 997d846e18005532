"""Surface points as PLY, LAS or LAZ: RGB, temperature and its error a point."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement

from rtgs import __version__
from rtgs.base.errors import RtgsError
from rtgs.base.files import write_whole
from rtgs.io.exports.surface import SurfacePoints
from rtgs.records.georeference import Georeference

# Metres east and north of a place are Transverse Mercator about it, to a millimetre within kilometres.
_TRANSVERSE_MERCATOR = (
    'PROJCS["metres east and north of a place",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
    'PARAMETER["latitude_of_origin",{0.latitude_deg:.12f}],PARAMETER["central_meridian",{0.longitude_deg:.12f}],'
    'PARAMETER["scale_factor",1],PARAMETER["false_easting",0],PARAMETER["false_northing",0],UNIT["metre",1]]'
)
_LAS_STEP = 1e-4  # of a unit: LAS holds positions as whole numbers of steps


def check_las() -> None:
    """Raises `RtgsError` where the library is missing."""
    try:
        import laspy
    except ImportError as error:
        raise RtgsError("LAS and LAZ need the library laspy: pip install 'rtgs[las]'.") from error
    if not laspy.LazBackend.detect_available():
        raise RtgsError("LAZ needs the library lazrs: pip install 'rtgs[las]'.")


def write_points_ply(path: Path, points: SurfacePoints, xyz: NDArray[np.float64], unit: str) -> None:
    """Write points as a PLY with doubles for positions; `path` appears whole or not at all."""
    columns = _columns(points, unit)
    kinds = [
        *((n, "<f8") for n in "xyz"),
        *((n, "u1") for n in ("red", "green", "blue")),
        *((n, c.dtype.str) for n, c in columns.items()),
    ]
    table = np.empty(len(points), dtype=kinds)
    for i, name in enumerate("xyz"):
        table[name] = xyz[:, i]
    for i, name in enumerate(("red", "green", "blue")):
        table[name] = np.rint(points.rgb[:, i] * 255)
    for name, column in columns.items():
        table[name] = column
    with write_whole(path) as temporary:
        PlyData([PlyElement.describe(table, "vertex")], text=False, byte_order="<").write(str(temporary))


def write_las(path: Path, points: SurfacePoints, xyz: NDArray[np.float64], unit: str, place: Georeference | None = None) -> None:
    """Write points as LAS 1.4, or compressed where the name ends in `.laz`; temperature and error are extra dimensions.

    Args:
        place: where the file's origin is on the Earth, if that is known: the file says so, and heights are altitudes.
    """
    import laspy

    header = laspy.LasHeader(version="1.4", point_format=7)
    header.generating_software = f"rtgs {__version__}"
    if place is not None:
        header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(_TRANSVERSE_MERCATOR.format(place)))
        header.global_encoding.wkt = True
        xyz = xyz + np.array([0.0, 0.0, place.altitude_m])
    header.scales, header.offsets = np.full(3, _LAS_STEP), np.floor(xyz.min(axis=0))
    columns = _columns(points, unit)
    header.add_extra_dims([laspy.ExtraBytesParams(name, column.dtype) for name, column in columns.items()])
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz.T
    for i, name in enumerate(("red", "green", "blue")):
        las[name] = np.rint(points.rgb[:, i] * 65535).astype(np.uint16)
    for name, column in columns.items():
        las[name] = column
    with write_whole(path) as temporary, temporary.open("wb") as file:
        las.write(file, do_compress=path.suffix == ".laz")


def _columns(points: SurfacePoints, unit: str) -> dict[str, NDArray]:
    name = "temperature" if unit == "°C" else "counts"
    found: dict[str, NDArray] = {name: points.temperature.astype("<f4")}
    if np.isfinite(points.error).any():
        found[f"{name}_std"] = points.error.astype("<f4")
    return found | {"views": points.views.astype("<i4")}
