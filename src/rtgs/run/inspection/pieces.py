"""Pieces of HTML that several sections share. Whatever comes in as text is escaped here or by the catalogue."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from rtgs.run.inspection.words import Words
from rtgs.run.report.values import minus


@dataclass(frozen=True)
class Row:
    """A named value.

    Attributes:
        key: of the field, as in the catalogue's `field.KEY` and `unit.KEY`.
        value: text or number; None or "": empty, and shown as such.
        from_files: whether the files say it, and not the user.
    """

    key: str
    value: str | float | None
    from_files: bool = False


def card(words: Words, key: str, inside: str, kind: str = "") -> str:
    """A section with the catalogue's title `section.KEY`."""
    return f'<section class="{kind}"><h2>{words(f"section.{key}")}</h2>{inside}</section>'


def fields(words: Words, rows: Sequence[Row]) -> str:
    """A list of fields. Empty ones are marked."""
    return "<dl>" + "".join(_field(words, row) for row in rows) + "</dl>"


def _field(words: Words, row: Row) -> str:
    if row.value is None or row.value == "":
        shown = f'<dd class="empty">{words("empty")}</dd>'
    else:
        text = row.value if isinstance(row.value, str) else minus(f"{row.value:g}")
        unit = words.texts.get(f"unit.{row.key}", "{}")
        source = f" <small>({words('from_files')})</small>" if row.from_files else ""
        shown = f"<dd>{html.escape(unit.format(text))}{source}</dd>"
    return f"<div><dt>{words(f'field.{row.key}')}</dt>{shown}</div>"


def lines(texts: Sequence[str]) -> str:
    """A list of sentences, which are HTML already; "" where there are none."""
    return "<ul>" + "".join(f"<li>{text}</li>" for text in texts) + "</ul>" if texts else ""


def paragraph(text: str, kind: str = "") -> str:
    """HTML in a paragraph."""
    return f'<p class="{kind}">{text}</p>' if kind else f"<p>{text}</p>"


def picture(image: Image.Image, alt: str, width_px: int) -> str:
    """The picture inside the page, at most so wide. alt: text, not escaped yet."""
    data, size = embedded(image, width_px)
    return f'<img src="{data}" alt="{html.escape(alt, quote=True)}" width="{size[0]}" height="{size[1]}">'


def embedded(image: Image.Image, width_px: int) -> tuple[str, tuple[int, int]]:
    """A data URI, and the size of what it holds."""
    if image.width > width_px:
        image = image.resize((width_px, max(1, round(image.height * width_px / image.width))), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=90, optimize=True)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode("ascii"), image.size


def file_name(path: Path) -> str:
    """A path as HTML that may break after a slash."""
    return html.escape(str(path)).replace("/", "/<wbr>")
