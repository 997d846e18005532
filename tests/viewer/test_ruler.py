"""Lengths, areas and heights, and the scale's interval on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.viewed_wall import CI95, TRUTH, estimate

from rtgs.base.errors import RtgsError
from rtgs.viewer.contents import Contents
from rtgs.viewer.ruler import FEWEST, KINDS, Kind, measure

SQUARE_M = np.array([[0.0, 0.0, 1.0], [0.3, 0.0, 1.0], [0.3, 0.4, 1.0], [0.0, 0.4, 1.0]])


@pytest.mark.parametrize(
    ("kind", "points", "value"),
    [
        ("distance", SQUARE_M[[0, 2]], 0.5),
        ("polyline", SQUARE_M, 1.0),
        ("area", SQUARE_M, 0.12),
        ("area", SQUARE_M[:3], 0.06),
        ("height above a plane", np.concatenate([SQUARE_M[:3], [[0.1, 0.1, 0.75]]]), 0.25),
    ],
)
def test_known_figures(contents: Contents, kind: Kind, points: np.ndarray, value: float) -> None:
    found = measure(kind, contents.world(points), contents)
    assert found.value == pytest.approx(value, rel=1e-6)
    assert found.unit == ("m²" if kind == "area" else "m") and found.note == ""


@pytest.mark.parametrize("kind", KINDS)
def test_the_interval_is_that_of_the_scale(contents: Contents, kind: Kind) -> None:
    points = np.concatenate([SQUARE_M[:3], [[0.1, 0.1, 0.75]]])
    found = measure(kind, contents.world(points), contents)
    power = 2 if kind == "area" else 1
    assert found.low is not None and found.high is not None
    assert found.low / found.value == pytest.approx((TRUTH / CI95[1]) ** power)
    assert found.high / found.value == pytest.approx((TRUTH / CI95[0]) ** power)
    assert "95 %" in str(found)


def test_a_run_without_scale_measures_in_sfm_units(contents: Contents) -> None:
    found = measure("distance", contents.world(SQUARE_M[:2]), replace(contents, scale=None))
    assert found.value == pytest.approx(0.3 * TRUTH) and found.unit == "SfM units" and found.low is None
    assert "not in metres" in found.note


def test_a_scale_in_doubt_says_so(contents: Contents) -> None:
    found = measure("distance", contents.world(SQUARE_M[:2]), replace(contents, scale=estimate("ambiguous")))
    assert "ambiguous" in found.note


@pytest.mark.parametrize("kind", KINDS)
def test_too_few_points_are_refused(contents: Contents, kind: Kind) -> None:
    with pytest.raises(RtgsError, match="points are needed"):
        measure(kind, SQUARE_M[: FEWEST[kind] - 1], contents)


def test_a_plane_needs_points_that_span_it(contents: Contents) -> None:
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 1]])
    with pytest.raises(RtgsError, match="one line"):
        measure("height above a plane", line, contents)
