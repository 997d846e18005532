"""Thermal features of surfaces: where they are, how wide they are, what they cover."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rtgs.synthetic.features import FeatureKind, ThermalFeature, area_m2
from rtgs.synthetic.model import Surface

SPOT = ThermalFeature(
    kind="spot",
    position_m=(1.0, 2.0, 3.0),
    normal=(0.0, 0.0, 1.0),
    along=(1.0, 0.0, 0.0),
    part=4,
    size_px=3.0,
    fwhm_m=0.04,
    length_m=0.04,
    area_m2=area_m2("spot", 0.04, 0.04),
    excess_c=-15.0,
    sign=-1,
    surroundings_c=20.0,
    peak_c=5.0,
    views=(),
)
LINE = replace(SPOT, kind="line", length_m=0.3, area_m2=area_m2("line", 0.04, 0.3))
RECTANGLE = replace(SPOT, kind="rectangle", length_m=0.06, area_m2=area_m2("rectangle", 0.04, 0.06))


def surface(offsets: NDArray[np.float64], *, normal: tuple[float, float, float] = (0, 0, 1), part: int = 4) -> Surface:
    """Points of the plane z = 3, by their offset from the features' centre."""
    world = np.array(SPOT.position_m) + np.column_stack([offsets, np.zeros(len(offsets))])
    normals = np.broadcast_to(np.array(normal, float), world.shape)
    n = len(world)
    return Surface(world, normals, world, normals, np.zeros((n, 3)), np.zeros(n), np.full(n, part))


def test_a_spot_has_half_of_its_excess_at_half_its_width() -> None:
    at = np.array([[0.0, 0.0], [0.02, 0.0], [0.0, -0.02], [0.04, 0.0]])
    np.testing.assert_allclose(SPOT.excess_at(surface(at)), [-15.0, -7.5, -7.5, -15.0 / 16])


def test_a_line_is_level_along_and_a_gaussian_across() -> None:
    at = np.array([[0.0, 0.0], [0.15, 0.0], [-0.1, 0.02], [0.17, 0.0]])
    np.testing.assert_allclose(LINE.excess_at(surface(at)), [-15.0, -15.0, -7.5, -7.5])


def test_a_rectangle_has_sharp_edges() -> None:
    at = np.array([[0.0299, 0.0199], [0.0301, 0.0], [0.0, 0.0201]])
    np.testing.assert_allclose(RECTANGLE.excess_at(surface(at)), [-15.0, 0.0, 0.0])


def test_the_far_side_and_other_parts_have_nothing() -> None:
    at = np.zeros((1, 2))
    for feature in (SPOT, LINE, RECTANGLE):
        assert feature.excess_at(surface(at, normal=(0, 0, -1))) == 0
        assert feature.excess_at(surface(at, part=5)) == 0


@pytest.mark.parametrize("feature", [SPOT, LINE, RECTANGLE], ids=lambda f: f.kind)
def test_the_area_is_where_at_least_half_of_the_excess_is(feature: ThermalFeature) -> None:
    step = 0.0005
    axis = np.arange(-0.25, 0.25, step) + step / 2
    x, y = np.meshgrid(axis, axis)
    excess = feature.excess_at(surface(np.column_stack([x.ravel(), y.ravel()])))
    assert (excess / feature.excess_c >= 0.5).sum() * step**2 == pytest.approx(feature.area_m2, rel=0.01)


@pytest.mark.parametrize(("kind", "expected"), [("spot", math.pi / 4), ("line", 3 + math.pi / 4), ("rectangle", 3.0)])
def test_areas(kind: FeatureKind, expected: float) -> None:
    assert area_m2(kind, 1.0, 3.0) == pytest.approx(expected)
