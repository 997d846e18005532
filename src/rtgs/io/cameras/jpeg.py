"""JPEG files with more in them than a picture: their headers and segments, without decoding a pixel."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

from rtgs.base.errors import RtgsError

# EXIF tags.
MAKE, MODEL, ORIENTATION, DATE_TIME, EXIF_IFD, GPS_IFD, SERIAL, LENS = 271, 272, 274, 306, 0x8769, 0x8825, 0xA431, 0xA434
EXPORT_AGAIN = "Copy the original file from the camera again; editing or sharing a picture drops or damages its thermal data."


@contextmanager
def opened(path: Path) -> Iterator[Image.Image]:
    """A picture's header and segments; its pixels are not decoded.

    Raises:
        RtgsError: no such file, or it is no image, or it is cut off within its segments.
    """
    try:
        with Image.open(path, formats=("JPEG",)) as image:
            yield image
    except FileNotFoundError as error:
        raise RtgsError(f"{path}: no such file.") from error
    except RtgsError:
        raise
    except Exception as error:  # besides its own errors, Pillow raises whatever its arithmetic with a damaged tag does
        raise RtgsError(f"{path}: cannot be read as a JPEG (empty, damaged or cut off). {EXPORT_AGAIN}") from error


def exif_text(value: object) -> str:
    """A text of EXIF without its padding; "" where it is absent."""
    return value.strip(" \0") if isinstance(value, str) else ""


def with_exif(jpeg: bytes, exif: bytes) -> bytes:
    """A JPEG with its EXIF replaced and its pixels untouched: nothing is decoded, so nothing is lost."""
    head, rest = [b"\xff\xd8", b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif], 2
    while jpeg[rest] == 0xFF and 0xE0 <= jpeg[rest + 1] <= 0xEF:  # APP0 … APP15
        end = rest + 2 + int.from_bytes(jpeg[rest + 2 : rest + 4], "big")
        if jpeg[rest + 4 : rest + 8] != b"Exif":
            head.append(jpeg[rest:end])
        rest = end
    return b"".join(head) + jpeg[rest:]
