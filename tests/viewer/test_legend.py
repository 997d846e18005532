"""The colour bar of a page."""

from __future__ import annotations

import re

import pytest

from rtgs.viewer.legend import colour_bar
from rtgs.viewer.picture import Look, Shade


def ticks(text: str) -> list[float]:
    return [float(v) for v in re.findall(r">(-?[\d.]+)</span>", text)]


@pytest.mark.parametrize(
    ("lo", "hi", "unit"), [(20.0, 30.0, "°C"), (-12.3, 1.7, "°F"), (19.98, 20.03, "K"), (0.0, 1500.0, "counts")]
)
def test_ticks_lie_in_the_range_and_are_few(lo: float, hi: float, unit: Shade) -> None:
    text = colour_bar(Look("Temperature", lo=lo, hi=hi), unit)
    found = ticks(text)
    assert 2 <= len(found) <= 6 and found == sorted(found) and unit in text
    places = [float(v) for v in re.findall(r"left:(-?[\d.]+)%;transform", text)]
    assert all(-0.1 <= p <= 100.1 for p in places)


def test_the_bar_is_in_the_unit_of_the_person() -> None:
    assert ticks(colour_bar(Look("Temperature", lo=0.0, hi=100.0), "°F"))[0] >= 32.0


def test_the_isotherm_is_marked() -> None:
    look = Look("Temperature", lo=20.0, hi=30.0, isotherm=(22.0, 24.0))
    assert "left:20.00%;width:20.00%" in colour_bar(look, "°C")
