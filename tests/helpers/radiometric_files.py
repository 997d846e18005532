"""Radiometric JPEGs made up for tests: FLIR's container around counts and parameters that a test chooses."""

from __future__ import annotations

import io
import os
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from rtgs.records.radiometry import ZERO_CELSIUS_K, ObjectParameters, PlanckCalibration, PlanckRadiometry

SAMPLES = Path(os.environ.get("RTGS_DATA", Path(__file__).parents[3] / "shared" / "data")) / "radiometric_jpeg"
needs_samples = pytest.mark.skipif(
    not SAMPLES.is_dir(), reason="the sample files radiometric_jpeg are not here (RTGS_DATA or ../shared/data)"
)

RADIOMETRY = PlanckRadiometry(
    PlanckCalibration(16000.0, 0.0125, 1420.0, 1.0, -4000), ObjectParameters(0.875, 22.0, 18.0, 2.0, 0.5, 20.0, 0.96875)
)
THERMAL_SIZE, VISIBLE_SIZE = (16, 12), (32, 24)
FIELD_OF_VIEW_DEG = 45.0
GPS = {0: b"\x02\x03\x00\x00", 1: "N", 2: (49.0, 0.0, 38.5), 3: "E", 4: (8.0, 25.0, 6.1), 5: b"\x00", 6: 115.5}


def counts_of(seed: int = 0) -> NDArray[np.uint16]:
    """Counts of 10 … 60 °C at random."""
    temperature_c = np.random.default_rng(seed).uniform(10, 60, THERMAL_SIZE[::-1])
    return RADIOMETRY.counts(temperature_c).round().astype(np.uint16)


def visible_of(seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (*VISIBLE_SIZE[::-1], 3), dtype=np.uint8)


def encoded(pixels: NDArray[Any], kind: str, **options: Any) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, kind, **options)
    return file.getvalue()


def image_record(order: str, size: tuple[int, int], body: bytes) -> bytes:
    return struct.pack(f"{order}HHH", 2, *size).ljust(32, b"\0") + body


def raw_record(counts: NDArray[np.uint16], order: str = "<", png: bool = True) -> bytes:
    size = (counts.shape[1], counts.shape[0])
    body = encoded(counts.byteswap(), "PNG") if png else counts.astype(f"{order}u2").tobytes()
    return image_record(order, size, body)


def camera_record(radiometry: PlanckRadiometry = RADIOMETRY, order: str = "<", per_cent: bool = False) -> bytes:
    p, c = radiometry.parameters, radiometry.calibration
    record = bytearray(0x400)
    fields: dict[int, tuple[str, float]] = {
        0x00: ("H", 2),
        0x20: ("f", p.emissivity),
        0x24: ("f", p.distance_m),
        0x28: ("f", p.reflected_c + ZERO_CELSIUS_K),
        0x2C: ("f", p.atmospheric_c + ZERO_CELSIUS_K),
        0x30: ("f", p.window_c + ZERO_CELSIUS_K),
        0x34: ("f", p.window_transmission),
        0x3C: ("f", p.relative_humidity * (100 if per_cent else 1)),
        0x58: ("f", c.r1),
        0x5C: ("f", c.b),
        0x60: ("f", c.f),
        0x70: ("f", c.atmosphere.alpha1),
        0x74: ("f", c.atmosphere.alpha2),
        0x78: ("f", c.atmosphere.beta1),
        0x7C: ("f", c.atmosphere.beta2),
        0x80: ("f", c.atmosphere.x),
        0x1B4: ("f", FIELD_OF_VIEW_DEG),
        0x308: ("i", int(c.o)),
        0x30C: ("f", c.r2),
    }
    for offset, (kind, value) in fields.items():
        struct.pack_into(order + kind, record, offset, value)
    for offset, text in ((0xD4, b"FLIR T0"), (0x104, b"12345"), (0x170, b"FOL9")):
        record[offset : offset + len(text)] = text
    return bytes(record)


def fusion_record(real2ir: float = 1.5, offset: tuple[int, int] = (1, -1)) -> bytes:
    return struct.pack("<fhh", real2ir, *offset).ljust(0x60, b"\0")


def records(counts: NDArray[np.uint16] | None = None, **changes: bytes | None) -> dict[int, bytes]:
    """A complete set; `raw`, `visible`, `camera`, `fusion` replace a record, or drop it with None."""
    made = {
        "raw": raw_record(counts_of() if counts is None else counts),
        "visible": image_record("<", VISIBLE_SIZE, encoded(visible_of(), "JPEG", quality=95)),
        "camera": camera_record(),
        "fusion": fusion_record(),
    } | changes
    kinds = {"raw": 0x01, "visible": 0x0E, "camera": 0x20, "fusion": 0x2A}
    return {kinds[name]: data for name, data in made.items() if data is not None}


def fff(made: dict[int, bytes], order: str = ">") -> bytes:
    """FLIR's file: header, directory with an empty entry first, records."""
    directory, body = bytes(32), b""
    start = 64 + 32 * (len(made) + 1)
    for kind, data in made.items():
        directory += struct.pack(f"{order}HHIIII", kind, 1, 0x64, 1, start + len(body), len(data)).ljust(32, b"\0")
        body += data
    header = b"FFF\0".ljust(0x14, b"\0") + struct.pack(f"{order}III", 101, 64, len(made) + 1)
    return header.ljust(64, b"\0") + directory + body


def flir_segments(data: bytes, chunk: int = 3000) -> list[bytes]:
    parts = [data[i : i + chunk] for i in range(0, len(data), chunk)]
    return [b"FLIR\0\x01" + bytes([i, len(parts) - 1]) + part for i, part in enumerate(parts)]


def jpeg(path: Path, segments: list[bytes], *, marker: int = 0xE1, exif: Image.Exif | None = None) -> Path:
    """A picture with application segments."""
    exif = camera_exif() if exif is None else exif
    picture = encoded(np.zeros((24, 32, 3), np.uint8), "JPEG", exif=exif)
    added = b"".join(bytes([0xFF, marker]) + (len(s) + 2).to_bytes(2, "big") + s for s in segments)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(picture[:2] + added + picture[2:])
    return path


def camera_exif(**tags: Any) -> Image.Exif:
    exif = Image.Exif()
    for tag, value in (
        {271: "FLIR Systems AB", 272: "FLIR T0", 306: "2024:05:06 07:08:09"} | {int(k[1:]): v for k, v in tags.items()}
    ).items():
        exif[tag] = value
    exif.get_ifd(0x8825).update(GPS)
    return exif


def flir_jpeg(path: Path, counts: NDArray[np.uint16] | None = None, **changes: bytes | None) -> Path:
    return jpeg(path, flir_segments(fff(records(counts, **changes))))
