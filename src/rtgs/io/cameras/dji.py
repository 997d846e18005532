"""DJI's radiometric JPEG (R-JPEG).

Cameras around a FLIR core (Zenmuse XT, XT2) write FLIR's thermal data and are read as such. The others (H20T, M30T, Mavic 3T …)
store counts whose calibration DJI keeps in the closed binaries of its Thermal SDK, and no published formula agrees with its results.
For those the temperatures come from a TIFF that a program built on the SDK has written.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.io.cameras.flir import is_flir, read_flir
from rtgs.io.cameras.jpeg import EXIF_IFD, MAKE, MODEL, exif_text, opened
from rtgs.io.cameras.protocol import CameraFormat, Shot
from rtgs.io.image_files import read_counts
from rtgs.records.radiometry import CELSIUS, ZERO_CELSIUS_K, CelsiusRadiometry

_FOCAL_LENGTH_35MM = 41989
_DIAGONAL_35MM = math.hypot(36, 24)
_VISIBLE_KINDS = ("W", "V")  # wide, visible; Z changes its focal length from shot to shot


@dataclass(frozen=True, eq=False)
class DjiImage:
    """One R-JPEG with its temperatures.

    Attributes:
        path: the R-JPEG.
        counts: `[h, w]`: uint16 from a FLIR core, float32 °C from a converted TIFF.
        radiometry: what makes °C of `counts`.
        model: as EXIF has it.
        focal_length_px: of the thermal camera; None when the file doesn't say.
    """

    path: Path
    counts: NDArray[np.generic]
    radiometry: CelsiusRadiometry
    model: str
    focal_length_px: float | None

    @property
    def temperature_c(self) -> NDArray[np.float32]:
        return self.radiometry.celsius(self.counts)


def is_dji(path: Path) -> bool:
    """Whether a JPEG is an R-JPEG by a DJI camera, by its segments alone.

    Raises:
        RtgsError: the file can't be read as an image.
    """
    return is_flir(path) or _camera_of_closed_data(path) is not None


def read_dji(path: Path) -> DjiImage:
    """Read an R-JPEG: from a FLIR core directly, otherwise through the converted TIFF of the same stem beside it.

    Raises:
        RtgsError: no R-JPEG; one that needs converting and hasn't been; the TIFF isn't °C in float; any reason of `read_flir`.
    """
    if is_flir(path):
        flir = read_flir(path)
        return DjiImage(path, flir.counts, flir.radiometry, flir.model, flir.focal_length_px or _focal_of(path, flir.counts))
    model = _camera_of_closed_data(path)
    if model is None:
        raise RtgsError(f"{path}: is no radiometric JPEG by DJI. The thermal one of a set is usually named …_T.JPG.")
    converted = next((p for suffix in (".tif", ".tiff", ".TIF", ".TIFF") if (p := path.with_suffix(suffix)).is_file()), None)
    if converted is None:
        raise RtgsError(
            f"{path}: is by a DJI {model}, whose counts only DJI's closed calibration turns into °C. Convert it, with a program built on "
            f"DJI's Thermal SDK, to a single-channel floating-point TIFF in °C, {path.stem}.tiff beside it, and try again."
        )
    temperature_c = read_counts(converted)
    if temperature_c.dtype.kind != "f":
        raise RtgsError(
            f"{converted}: holds whole numbers, and nothing says what unit they are. Convert {path.name} to floating-point °C; or put "
            "the files into a capture by hand and give celsius_per_count and celsius_offset in its rig.json."
        )
    if temperature_c.min() <= -ZERO_CELSIUS_K:
        raise RtgsError(
            f"{converted}: its lowest value is {temperature_c.min():g}, no temperature in °C. Convert {path.name} again."
        )
    return DjiImage(path, temperature_c, CELSIUS, model, _focal_of(path, temperature_c))


def visible_partner(path: Path) -> Path | None:
    """The visible picture of the same shot: …_0001_T.JPG goes with …_0001_W.JPG, or with …_0001_V.JPG.

    The time in a name may differ by a second between the two, so without one of the same name the shot's number decides.

    Raises:
        RtgsError: several pictures carry that number.
    """
    parts = re.fullmatch(r"(.*)_(\d+)_T", path.stem, re.IGNORECASE)
    if parts is None:
        return None
    head, number = parts.groups()
    for kind in _VISIBLE_KINDS:
        same_number = re.compile(rf".*_{number}_{kind}\.jpe?g", re.IGNORECASE)
        found = sorted(p for p in path.parent.iterdir() if same_number.fullmatch(p.name) and not p.name.startswith("."))
        same_name = [p for p in found if p.stem.lower() == f"{head}_{number}_{kind}".lower()]
        if same_name or len(found) == 1:
            return (same_name or found)[0]
        if found:
            raise RtgsError(
                f"{path}: {', '.join(p.name for p in found)} carry the same number. Put each flight's pictures into a folder of its own."
            )
    return None


def frame_name(path: Path) -> str:
    """A shot's name without what tells its pictures apart: …_0001_T.JPG is …_0001."""
    return re.sub(r"_T$", "", path.stem, flags=re.IGNORECASE)


def focal_length_px(path: Path, size: tuple[int, int] | None = None) -> float | None:
    """From EXIF's 35 mm equivalent, taken over the diagonal: nominal, good to a few per cent. None when absent.

    `size` is the width and height of the image that the pixels belong to; the JPEG's own picture where none is given. The picture of a
    thermal JPEG may be enlarged: 1280×1024 for 640×512 counts.
    """
    with opened(path) as image:
        equivalent_mm = float(image.getexif().get_ifd(EXIF_IFD).get(_FOCAL_LENGTH_35MM) or 0)
        return math.hypot(*(size or image.size)) * equivalent_mm / _DIAGONAL_35MM if equivalent_mm > 0 else None


def _focal_of(path: Path, counts: NDArray[np.generic]) -> float | None:
    height, width = counts.shape
    return focal_length_px(path, (width, height))


def _camera_of_closed_data(path: Path) -> str | None:
    """The model of a DJI camera whose counts stand in APP3 segments; None for any other file."""
    with opened(path) as image:
        exif = image.getexif()
        make, model = (exif_text(exif.get(tag)) for tag in (MAKE, MODEL))
        thermal = any(name == "APP3" for name, _ in getattr(image, "applist", []))
    return (model or "camera") if make.upper() == "DJI" and thermal else None


class DjiFormat:
    """DJI's files for an import (`CameraFormat`). The visible picture of a shot is a file beside the thermal one."""

    def recognises(self, path: Path) -> bool:
        return is_dji(path)

    def frame_name(self, path: Path) -> str:
        return frame_name(path)

    def read(self, path: Path) -> Shot:
        image, name = read_dji(path), frame_name(path)
        looked_for = " or ".join(f"{name}_{kind}.JPG" for kind in _VISIBLE_KINDS)
        said = f"no visible picture of this shot is beside it ({looked_for})"
        return Shot(image.counts, image.radiometry, image.focal_length_px, None, said)

    def visible_partner(self, path: Path) -> Path | None:
        return visible_partner(path)

    def visible_focal_px(self, path: Path) -> float | None:
        return focal_length_px(path)


FORMAT: CameraFormat = DjiFormat()
