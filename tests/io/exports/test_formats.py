"""The table of formats."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

from rtgs.config import ExportFormat
from rtgs.io.exports.formats import FORMATS

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "export.md"


def test_the_table_has_what_the_command_line_offers() -> None:
    assert tuple(FORMATS) == get_args(ExportFormat)


def test_the_page_has_a_row_for_each() -> None:
    rows = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    for name in FORMATS:
        assert any(f"`{name}`" in row.split("|")[1] for row in rows), name


def test_formats_without_a_place_for_temperatures_say_so() -> None:
    for name in ("compressed-ply", "spz"):
        assert "°C" in FORMATS[name].cannot_hold
    assert not any("°C" in FORMATS[name].cannot_hold for name in ("ply", "glb", "usd", "points-las", "orthophoto"))
