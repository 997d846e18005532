"""Pieces of HTML that several sections share."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from PIL import Image

from rtgs.base.errors import RtgsError
from rtgs.run.report.run_records import RunRecords
from rtgs.run.report.values import evenly

MOST_FRAMES = 6
PICTURE_WIDTH_PX = 560
_LARGEST_PX = 32_000  # none of a run is so large, and JPEG holds no more than twice that


def section(title: str, inside: str) -> str:
    """A titled card; "" where there is nothing inside."""
    return f"<section><h2>{html.escape(title)}</h2>{inside}</section>" if inside else ""


def missing(run: RunRecords, what: str) -> str:
    """A sentence that names what the run has not made yet, and the command that makes it."""
    return f'<p class="missing">This run has no {html.escape(what)} yet. To make it: <code>{html.escape(run.command)}</code></p>'


def facts(values: Mapping[str, Any]) -> str:
    """A list of names and values, without those that are None. A path may break a line after a slash."""
    texts = {k: html.escape(str(v)) for k, v in values.items() if v is not None}
    texts |= {k: texts[k].replace("/", "/<wbr>") for k, v in values.items() if isinstance(v, Path)}
    rows = "".join(f"<div><dt>{k}</dt><dd>{text}</dd></div>" for k, text in texts.items())
    return f"<dl>{rows}</dl>" if rows else ""


def wide(table: str, kind: str = "") -> str:
    """A table that scrolls sideways where the screen is narrow. kind: its CSS classes."""
    name = f' class="{kind}"' if kind else ""
    return f'<div class="wide"><table{name}>{table}</table></div>'


def frame_names(run: RunRecords, folder: str, what: str, at_most: int = MOST_FRAMES) -> list[str]:
    """Frames that have `renders/folder/NAME.what.png`, evenly chosen in name order."""
    end = f".{what}.png"
    found = sorted(p.name.removesuffix(end) for p in (run.path / "renders" / folder).glob(f"*{end}") if p.name != end)
    return [found[i] for i in evenly(len(found), at_most)]


def picture(run: RunRecords, folder: str, name: str, what: str) -> Path:
    """Where the evaluation writes a picture of a frame."""
    return run.path / "renders" / folder / f"{name}.{what}.png"


def read_picture(path: Path, made_by: str = "rtgs eval") -> Image.Image:
    """A PNG file in RGB. made_by: the command that draws it again.

    Raises:
        RtgsError: the file is not a picture.
    """
    try:
        with Image.open(path, formats=("PNG",)) as opened:
            if max(opened.size) > _LARGEST_PX:
                raise ValueError(f"{opened.width}×{opened.height} pixels")
            return opened.convert("RGB")
    except Exception as error:  # Pillow raises a dozen kinds for a damaged file
        raise RtgsError(
            f"{path}: not a picture that can be read ({error!s:.200}). Remove it; `{made_by}` draws it again."
        ) from error


def figure(path: Path, caption: str, *, sharp: bool = False, made_by: str = "rtgs eval") -> str:
    """The picture inside the page; "" where there is no such file.

    Args:
        sharp: keep thin coloured lines, which JPEG would blur.
        made_by: the command that draws the picture.

    Raises:
        RtgsError: the file is not a picture.
    """
    if not path.is_file():
        return ""
    image = read_picture(path, made_by)
    if image.width > PICTURE_WIDTH_PX:
        height = max(1, round(image.height * PICTURE_WIDTH_PX / image.width))
        image = image.resize((PICTURE_WIDTH_PX, height), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    if sharp:
        image.save(buffer, "PNG", optimize=True)
    else:
        image.save(buffer, "JPEG", quality=88, optimize=True)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    kind = "png" if sharp else "jpeg"
    alt = html.escape(f"{path.name.removesuffix('.png')}: {caption}", quote=True)
    return (
        f'<figure style="flex:{image.width / image.height:.4f} 1 0">'
        f'<img src="data:image/{kind};base64,{data}" alt="{alt}" width="{image.width}" height="{image.height}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )
