"""Palettes, isotherms, units and layouts."""

from __future__ import annotations

import numpy as np
import pytest

from rtgs.images.pictures import palette
from rtgs.maths.geometry import SE3
from rtgs.viewer.engine import Eye, Seen
from rtgs.viewer.picture import (
    GAP_PX,
    ISOTHERM,
    PALETTES,
    Frame,
    Look,
    Shade,
    beside,
    difference_in_unit,
    from_unit,
    in_unit,
    on_screen,
    percentiles,
    picture_of,
    swept,
    thermal_picture,
)

TEMPERATURE = np.linspace(10, 30, 12, dtype=np.float32).reshape(3, 4)
EYE = Eye.of(4, 3, 1.0, SE3.identity())


def test_the_isotherm_covers_its_band_and_nothing_else() -> None:
    picture = thermal_picture(TEMPERATURE, Look("Temperature", lo=10, hi=30, isotherm=(15, 20)))
    green = (picture == ISOTHERM).all(axis=2)
    np.testing.assert_array_equal(green, (TEMPERATURE >= 15) & (TEMPERATURE <= 20))


@pytest.mark.parametrize("name", PALETTES.values())
def test_every_palette_is_known(name: str) -> None:
    np.testing.assert_array_equal(
        thermal_picture(TEMPERATURE, Look("Temperature", name, 10, 30)), palette(TEMPERATURE, 10, 30, name)
    )


def test_a_blend_lies_between_both() -> None:
    seen = Seen(EYE, np.full((3, 4, 3), 0.5, np.float32), TEMPERATURE)
    rgb, warm = (picture_of(seen, Look(show, lo=10, hi=30)).astype(int) for show in ("RGB", "Temperature"))
    for share in (0.0, 0.3, 1.0):
        mixed = picture_of(seen, Look("Blend", lo=10, hi=30, blend=share)).astype(int)
        assert np.abs(mixed - ((1 - share) * rgb + share * warm)).max() <= 1


def test_a_missing_model_is_gray() -> None:
    assert len(np.unique(picture_of(Seen(EYE), Look("Temperature")).reshape(-1, 3), axis=0)) == 1


def test_layouts() -> None:
    left, right = np.zeros((4, 20, 3), np.uint8), np.full((4, 20, 3), 200, np.uint8)
    assert beside(left, right).shape == (4, 40 + GAP_PX, 3)
    half = swept(left, right, 0.5)
    assert (half[:, :8] == 0).all() and (half[:, 8:12] == 255).all() and (half[:, 12:] == 200).all()
    assert (swept(left, right, 0.0)[:, 2:] == 200).all() and (swept(left, right, 1.0)[:, :18] == 0).all()


@pytest.mark.parametrize(("width", "height"), [(100, 40), (40, 100), (33, 33), (7, 90)])
def test_a_picture_fits_a_screen_and_pixels_are_found_again(width: int, height: int) -> None:
    picture = np.full((20, 30, 3), 255, np.uint8)
    assert on_screen(picture, width, height).shape == (height, width, 3)
    frame = Frame.of(30, 20, width, height)
    assert frame.pixel(width / 2, height / 2) == pytest.approx((15, 10))
    assert frame.pixel(frame.left, frame.top) == pytest.approx((0, 0))


@pytest.mark.parametrize(("unit", "shown"), [("°C", 20.0), ("°F", 68.0), ("K", 293.15), ("counts", 20.0)])
def test_units(unit: Shade, shown: float) -> None:
    assert in_unit(20.0, unit) == pytest.approx(shown)
    assert from_unit(in_unit(20.0, unit), unit) == pytest.approx(20.0)
    assert in_unit(21.0, unit) - in_unit(20.0, unit) == pytest.approx(difference_in_unit(1.0, unit))


def test_percentiles_leave_out_what_is_unknown() -> None:
    values = np.append(TEMPERATURE.ravel(), np.float32(np.nan)).astype(np.float32)
    assert percentiles(values, 0, 100) == pytest.approx((10, 30))
    assert percentiles(np.array([np.nan], np.float32), 2, 98) is None
