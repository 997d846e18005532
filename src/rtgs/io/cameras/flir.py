"""FLIR's radiometric JPEG: raw sensor counts, calibration and object parameters, and the visible image that most files carry.

A JPEG's APP1 segments that begin with "FLIR" hold, in order, one FFF file: a directory of records, each of its own byte order.
The layout is that of ExifTool's documentation of FLIR tags (https://exiftool.org/TagNames/FLIR.html).
"""

from __future__ import annotations

import io
import math
import struct
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rtgs.base.errors import RtgsError
from rtgs.io.cameras.jpeg import (
    DATE_TIME,
    EXIF_IFD,
    EXPORT_AGAIN,
    GPS_IFD,
    LENS,
    MAKE,
    MODEL,
    ORIENTATION,
    SERIAL,
    exif_text,
    opened,
    with_exif,
)
from rtgs.io.cameras.protocol import CameraFormat, Shot, VisiblePicture
from rtgs.io.image_files import IMAGE_FORMATS
from rtgs.records.radiometry import ZERO_CELSIUS_K, Atmosphere, ObjectParameters, PlanckCalibration, PlanckRadiometry

_RAW, _VISIBLE, _CAMERA, _FUSION = 0x01, 0x0E, 0x20, 0x2A
_HEADER_BYTES, _ENTRY_BYTES, _IMAGE_HEADER_BYTES = 64, 32, 32
_DIGITAL_ZOOM, _LAST_GPS_TAG = 41988, 31
_CLEARLY_SMOOTHER = 2.0  # the wrong byte order makes neighbouring pixels differ about a hundred times more


@dataclass(frozen=True)
class Fusion:
    """How the camera lays the visible picture under the thermal one.

    Attributes:
        real2ir: how many times wider the visible camera sees than the thermal image, times the digital zoom in use.
        offset_x, offset_y: where the thermal image's centre lies in the visible picture, from its centre, in its pixels, at the distance
            focused on. (So it is on sample files of two cameras, by registering edges.)
        digital_zoom: the EXIF DigitalZoomRatio, 1 when absent.
    """

    real2ir: float
    offset_x: int
    offset_y: int
    digital_zoom: float


@dataclass(frozen=True, eq=False)
class FlirImage:
    """One radiometric JPEG.

    Attributes:
        path: the file.
        counts: `[h, w]` uint16, as the sensor gave them.
        radiometry: the camera's calibration with the object parameters that were set when it was taken.
        visible_file: the embedded visible image, an encoded JPEG or PNG; None when the file has none.
        make, model, serial, lens: as written, "" when absent.
        field_of_view_deg: the angle that `w` pixels span; None when absent.
        fusion: None when absent.
        gps: the EXIF GPS directory by tag number, empty when absent.
        captured_at: local time of the camera's clock, None when absent.
    """

    path: Path
    counts: NDArray[np.uint16]
    radiometry: PlanckRadiometry
    visible_file: bytes | None
    make: str
    model: str
    serial: str
    lens: str
    field_of_view_deg: float | None
    fusion: Fusion | None
    gps: dict[int, object]
    captured_at: datetime | None

    @property
    def temperature_c(self) -> NDArray[np.float32]:
        """`[h, w]`, under the file's own object parameters."""
        return self.radiometry.celsius(self.counts)

    @property
    def focal_length_px(self) -> float | None:
        """Of the thermal camera, from its field of view; None when the file has none."""
        if self.field_of_view_deg is None:
            return None
        return self.counts.shape[1] / 2 / math.tan(math.radians(self.field_of_view_deg) / 2)


def is_flir(path: Path) -> bool:
    """Whether a JPEG has FLIR's thermal data in it, by its segments alone.

    Raises:
        RtgsError: the file can't be read as an image.
    """
    with opened(path) as image:
        return bool(_flir_chunks(image))


def read_flir(path: Path) -> FlirImage:
    """Read a radiometric JPEG by FLIR, or by a camera around a FLIR core (DJI Zenmuse XT and XT2).

    Raises:
        RtgsError: no JPEG, no thermal data in it, a segment or record cut off or damaged, no usable calibration, an EXIF orientation.
    """
    with opened(path) as image:
        chunks = _flir_chunks(image)
        exif = image.getexif()
        tags = {tag: exif.get(tag) for tag in (MAKE, MODEL, ORIENTATION, DATE_TIME)}
        digital_zoom = exif.get_ifd(EXIF_IFD).get(_DIGITAL_ZOOM)
        gps = {tag: value for tag, value in exif.get_ifd(GPS_IFD).items() if tag <= _LAST_GPS_TAG}  # AX8: a stray pointer
    if not chunks:
        raise RtgsError(
            f"{path}: holds no FLIR thermal data, only a picture of it. Export it as radiometric JPEG, or copy the camera's original."
        )
    if tags[ORIENTATION] not in (None, 0, 1):
        raise RtgsError(
            f"{path}: has EXIF orientation {tags[ORIENTATION]}; the thermal and the visible image in it are stored unturned, and "
            "one rig.json needs both cameras upright in every frame. Take the frames in the camera's own orientation."
        )
    records = _records(path, _joined(path, chunks))
    for kind, what in ((_RAW, "raw thermal image"), (_CAMERA, "calibration")):
        if kind not in records:
            raise RtgsError(f"{path}: its FLIR data has no {what}. {EXPORT_AGAIN}")
    camera = _Record(path, "calibration", records[_CAMERA])
    fov = camera.number("f", 0x1B4)
    return FlirImage(
        path=path,
        counts=_counts(path, records[_RAW]),
        radiometry=_radiometry(path, camera),
        visible_file=_visible(path, records[_VISIBLE]) if _VISIBLE in records else None,
        make=exif_text(tags[MAKE]),
        model=camera.text(0xD4, 32) or exif_text(tags[MODEL]),
        serial=camera.text(0x104, 16),
        lens=camera.text(0x170, 32),
        field_of_view_deg=fov if 0 < fov < 180 else None,
        fusion=_fusion(path, records[_FUSION], digital_zoom) if _FUSION in records else None,
        gps=gps,
        captured_at=_date_time(tags[DATE_TIME]),
    )


# ---------------------------------------------------------------------------------------------------- container


def _flir_chunks(image: Image.Image) -> list[bytes]:
    """Payloads of the FLIR segments, "FLIR\\0" taken off: a byte 1, the chunk's index, the last index, data."""
    return [data[5:] for name, data in getattr(image, "applist", []) if name == "APP1" and data[:5] == b"FLIR\0"]


def _joined(path: Path, chunks: list[bytes]) -> bytes:
    last = chunks[0][2] if len(chunks[0]) > 3 else -1
    by_index = {chunk[1]: chunk[3:] for chunk in chunks if len(chunk) > 3 and chunk[2] == last}
    if len(by_index) != len(chunks) or sorted(by_index) != list(range(last + 1)):
        raise RtgsError(f"{path}: has {len(chunks)} of the {last + 1} segments of its FLIR data. {EXPORT_AGAIN}")
    return b"".join(by_index[i] for i in range(last + 1))


def _records(path: Path, fff: bytes) -> dict[int, bytes]:
    """The first record of each type."""
    damaged = RtgsError(f"{path}: the directory of its FLIR data is damaged. {EXPORT_AGAIN}")
    if len(fff) < _HEADER_BYTES or fff[:4] not in (b"FFF\0", b"AFF\0"):
        raise damaged
    order = next((o for o in "><" if 100 <= struct.unpack_from(f"{o}I", fff, 0x14)[0] < 200), None)  # the version says which
    if order is None:
        raise damaged
    start, entries = struct.unpack_from(f"{order}II", fff, 0x18)
    if start + entries * _ENTRY_BYTES > len(fff):
        raise damaged
    records: dict[int, bytes] = {}
    for i in range(entries):
        kind, _, _, _, offset, length = struct.unpack_from(f"{order}HHIIII", fff, start + i * _ENTRY_BYTES)
        if kind == 0 or kind in records:
            continue
        if offset + length > len(fff):
            raise RtgsError(f"{path}: record {kind:#x} of its FLIR data is cut off. {EXPORT_AGAIN}")
        records[kind] = fff[offset : offset + length]
    return records


class _Record:
    """A record and its byte order, which its first number tells: it is 2."""

    def __init__(self, path: Path, what: str, data: bytes) -> None:
        self.path, self.what, self.data = path, what, data
        order = next((o for o in "<>" if len(data) >= 2 and struct.unpack_from(f"{o}H", data)[0] == 2), None)
        if order is None:
            raise RtgsError(f"{path}: the {what} in its FLIR data is damaged. {EXPORT_AGAIN}")
        self.order: str = order

    def number(self, kind: str, offset: int) -> float:
        """A number at an offset; `kind` is `struct`'s letter."""
        if offset + struct.calcsize(kind) > len(self.data):
            raise RtgsError(f"{self.path}: the {self.what} in its FLIR data is cut off. {EXPORT_AGAIN}")
        value = struct.unpack_from(self.order + kind, self.data, offset)[0]
        return float(str(np.float32(value))) if kind == "f" else float(value)  # 0.95, not 0.949999988

    def text(self, offset: int, length: int) -> str:
        return self.data[offset : offset + length].split(b"\0")[0].decode("ascii", "replace").strip()


# ---------------------------------------------------------------------------------------------------- records


def _counts(path: Path, data: bytes) -> NDArray[np.uint16]:
    record = _Record(path, "raw thermal image", data)
    width, height = int(record.number("H", 2)), int(record.number("H", 4))
    body = data[_IMAGE_HEADER_BYTES:]
    counts: NDArray[np.uint16]
    if body.startswith(b"\x89PNG"):
        counts = _in_byte_order(path, _decode(path, "raw thermal image", body, (width, height)).astype(np.uint16))
    elif body.startswith(b"\xff\xd8"):
        raise RtgsError(
            f"{path}: its raw thermal image is JPEG-compressed, which is not supported. Save it again with FLIR Tools or Ignite."
        )
    else:
        if width == 0 or height == 0 or len(body) < 2 * width * height:
            raise RtgsError(f"{path}: its raw thermal image is cut off. {EXPORT_AGAIN}")
        counts = np.frombuffer(body, f"{record.order}u2", width * height).reshape(height, width).astype(np.uint16)
    if counts.shape != (height, width):
        found = "×".join(map(str, counts.shape[::-1]))
        raise RtgsError(f"{path}: its raw thermal image is {found} where {width}×{height} is announced. {EXPORT_AGAIN}")
    return counts


def _in_byte_order(path: Path, stored: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The counts of a PNG. PNG is big-endian by definition; most cameras write their numbers into it the other way round.

    Neighbouring pixels of a photograph differ little. In the wrong order the low byte weighs most, and they differ by a lot.
    """
    swapped = stored.byteswap()
    rough, rough_swapped = (_roughness(counts) for counts in (stored, swapped))
    if max(rough, rough_swapped) < _CLEARLY_SMOOTHER * min(rough, rough_swapped):
        raise RtgsError(
            f"{path}: the byte order of its raw thermal image cannot be told, because both orders give an image as rough as the other. "
            "Save it again with FLIR Tools or Ignite, or remove this frame."
        )
    return swapped if rough_swapped <= rough else stored


def _roughness(counts: NDArray[np.uint16]) -> float:
    """Mean difference of neighbouring pixels, in counts."""
    numbers = counts.astype(np.float64)
    return float(sum(np.abs(np.diff(numbers, axis=axis)).sum() for axis in (0, 1)) / numbers.size)


def _radiometry(path: Path, camera: _Record) -> PlanckRadiometry:
    emissivity, distance, reflected, air, window, transmission = (camera.number("f", 0x20 + 4 * i) for i in range(6))
    if transmission == 1 and not window > 0:
        window = air  # there is no window, and its temperature was left empty
    humidity = camera.number("f", 0x3C)
    r1, b, f = (camera.number("f", 0x58 + 4 * i) for i in range(3))
    atmosphere = Atmosphere(*(camera.number("f", 0x70 + 4 * i) for i in range(5)))
    try:
        calibration = PlanckCalibration(r1, camera.number("f", 0x30C), b, f, camera.number("i", 0x308), atmosphere)
        parameters = ObjectParameters(
            emissivity=emissivity,
            reflected_c=_celsius(reflected),
            atmospheric_c=_celsius(air),
            distance_m=distance,
            relative_humidity=humidity / 100 if humidity > 2 else humidity,  # some cameras write per cent
            window_c=_celsius(window),
            window_transmission=transmission,
        )
    except RtgsError as error:
        raise RtgsError(f"{path}: {error} The camera wrote no usable calibration into this file.") from error
    try:
        return PlanckRadiometry(calibration, parameters)
    except RtgsError as error:
        raise RtgsError(
            f"{path}: {error} Correct the object parameters in the camera maker's program and save the file again."
        ) from error


def _celsius(kelvin: float) -> float:
    return round(kelvin - ZERO_CELSIUS_K, 4)  # float32 kelvins are 3e-5 apart


def _visible(path: Path, data: bytes) -> bytes:
    body = data[_IMAGE_HEADER_BYTES:]
    _decode(path, "embedded visible image", body)  # here, not when a long import is half done
    return body


def _fusion(path: Path, data: bytes, digital_zoom: object) -> Fusion | None:
    if len(data) < 8:
        raise RtgsError(f"{path}: the fusion settings in its FLIR data are cut off. {EXPORT_AGAIN}")
    try:
        zoom = float(digital_zoom)  # type: ignore[arg-type]  # a rational, or None
    except (TypeError, ValueError, ZeroDivisionError):
        zoom = 1.0
    for order in "<>":
        real2ir, x, y = struct.unpack_from(f"{order}fhh", data)
        if 0.01 < real2ir < 100:  # the other byte order gives 1e±38
            return Fusion(real2ir, x, y, zoom if zoom > 0 else 1.0)
    return None


def _decode(path: Path, what: str, body: bytes, size: tuple[int, int] | None = None) -> NDArray[Any]:
    """The pixels of an embedded file, of that width and height if any is announced: memory is taken for no other."""
    try:
        with Image.open(io.BytesIO(body), formats=IMAGE_FORMATS) as image:
            if size is not None and image.size != size:
                raise ValueError(f"it is {image.width}×{image.height} where {size[0]}×{size[1]} is announced")
            return np.asarray(image)
    except Exception as error:  # Pillow raises a dozen kinds for a damaged file
        raise RtgsError(f"{path}: its {what} is damaged ({error!s:.200}). {EXPORT_AGAIN}") from error


def _date_time(value: object) -> datetime | None:
    try:
        return datetime.strptime(exif_text(value), "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None


# ---------------------------------------------------------------------------------------------------- for an import


class FlirFormat:
    """FLIR's files for an import (`CameraFormat`)."""

    def recognises(self, path: Path) -> bool:
        return is_flir(path)

    def frame_name(self, path: Path) -> str:
        return path.stem

    def read(self, path: Path) -> Shot:
        image = read_flir(path)
        return Shot(
            image.counts,
            image.radiometry,
            image.focal_length_px,
            _embedded(image),
            f"has no visible image in it ({image.model or 'unknown camera'})",
        )

    def visible_partner(self, path: Path) -> Path | None:
        return None  # these cameras embed the visible picture

    def visible_focal_px(self, path: Path) -> float | None:
        return None


FORMAT: CameraFormat = FlirFormat()


def _embedded(image: FlirImage) -> VisiblePicture | None:
    """The embedded picture as a file of its own, with the camera, its serial number and lens, time and GPS of the file around it.

    How much wider the visible camera sees, and where the thermal image lies in its picture, are the camera's fusion settings.
    """
    if image.visible_file is None:
        return None
    exif = Image.Exif()
    time = image.captured_at.strftime("%Y:%m:%d %H:%M:%S") if image.captured_at else ""
    for tag, text in ((MAKE, image.make), (MODEL, image.model), (DATE_TIME, time)):
        if text:
            exif[tag] = text
    for tag, text in ((SERIAL, image.serial), (LENS, image.lens)):
        if text:
            exif.get_ifd(EXIF_IFD)[tag] = text
    if image.gps:
        exif.get_ifd(GPS_IFD).update(image.gps)
    with Image.open(io.BytesIO(image.visible_file), formats=IMAGE_FORMATS) as picture:
        width = picture.width
        if image.visible_file.startswith(b"\xff\xd8"):
            file, suffix = with_exif(image.visible_file, exif.tobytes()), ".jpg"
        else:
            target = io.BytesIO()
            picture.save(target, "PNG", exif=exif)
            file, suffix = target.getvalue(), ".png"
    fusion, focal, hint = image.fusion, image.focal_length_px, None
    if fusion is None:
        return VisiblePicture(file, suffix)
    if focal is not None:
        hint = focal * width / image.counts.shape[1] / (fusion.real2ir / max(1.0, fusion.digital_zoom))
    return VisiblePicture(file, suffix, focal_hint_px=hint, thermal_centre_px=(float(fusion.offset_x), float(fusion.offset_y)))
