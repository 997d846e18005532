"""Which camera took a photograph, and when, as the file's EXIF says. Nothing is decoded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rtgs.io.image_files import opened

_MAKE, _MODEL, _DATE_TIME, _EXIF_IFD, _DATE_TIME_ORIGINAL, _SERIAL, _LENS = 0x010F, 0x0110, 0x0132, 0x8769, 0x9003, 0xA431, 0xA434


@dataclass(frozen=True)
class CameraTags:
    """Texts of EXIF; "" where the file does not say.

    Attributes:
        camera: make and model. serial: of the body. lens: its model.
        taken: "2026-05-01 10:20:30", by the camera's clock.
    """

    camera: str = ""
    serial: str = ""
    lens: str = ""
    taken: str = ""


def read_camera_tags(path: Path) -> CameraTags:
    """Raises `RtgsError` where the file is no readable image. A tag that is damaged counts as absent."""
    with opened(path) as image:
        try:
            exif = image.getexif()
            make, model, general = (_text(exif.get(tag)) for tag in (_MAKE, _MODEL, _DATE_TIME))
            inner = exif.get_ifd(_EXIF_IFD)
            original, serial, lens = (_text(inner.get(tag)) for tag in (_DATE_TIME_ORIGINAL, _SERIAL, _LENS))
        except Exception:  # a damaged entry, of which Pillow raises many kinds: the image is good without it
            return CameraTags()
    camera = model if model.upper().startswith(make.upper()) else f"{make} {model}".strip()
    date, _, time = (original or general).partition(" ")
    return CameraTags(camera, serial, lens, f"{date.replace(':', '-')} {time}".strip())


def _text(value: Any) -> str:
    return "".join(c for c in value if c.isprintable()).strip() if isinstance(value, str) else ""
