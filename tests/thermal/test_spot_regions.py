"""Hot spots in one view: found by what stands out from the same surface, grown to half of the excess."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from rtgs.thermal.spot_regions import Region, highest, regions_by_excess, regions_by_threshold

Y, X = np.mgrid[:90, :120].astype(float)
SLANTED = 2.0 + 0.01 * X + 0.004 * Y  # depth of a slanted wall


def image_of(region: Region) -> NDArray[np.bool_]:
    image = np.zeros(X.shape, bool)
    image[region.rows, region.columns] = True
    return image


def wall(*spots: tuple[float, float, float, float]) -> NDArray[np.float64]:
    """20 °C and a gradient, with spots (row, column, °C, FWHM)."""
    image = 20 + 0.02 * X
    for row, column, height, fwhm in spots:
        image += height * np.exp(-4 * math.log(2) * ((Y - row) ** 2 + (X - column) ** 2) / fwhm**2)
    return image


@pytest.mark.parametrize("fwhm", [2.0, 3.0, 5.0, 8.0, 14.0])
def test_a_spot_is_found_as_far_as_half_of_its_excess_goes(fwhm: float) -> None:
    (found,) = regions_by_excess(wall((40, 60, 15.0, fwhm)), SLANTED, 3.0)
    assert found.peak == (40, 60)
    assert found.area_px == pytest.approx(math.pi * fwhm**2 / 4, rel=0.2)
    assert found.extreme >= 20 + 0.02 * 60 + 15 - 0.05
    assert image_of(found).sum() == pytest.approx(found.area_px, rel=0.1, abs=2.5)
    assert found.surroundings == pytest.approx(21.3, abs=1.0)


@pytest.mark.parametrize("fwhm", [2.0, 3.0, 5.0])
def test_a_pixels_mean_neither_lowers_the_peak_nor_widens_the_spot(fwhm: float) -> None:
    """Pixels are means over 8 × 8 points of a spot that is anywhere in the middle one."""
    fine = (np.arange(8 * 41) + 0.5) / 8 - 0.5
    for dy, dx in ((0.0, 0.0), (0.5, 0.5), (0.2, -0.3)):
        y, x = fine[:, None] - 20 - dy, fine[None] - 20 - dx
        spot = 20 + 15 * np.exp(-4 * math.log(2) * (x**2 + y**2) / fwhm**2)
        image = spot.reshape(41, 8, 41, 8).mean(axis=(1, 3))
        (found,) = regions_by_excess(image, np.full(image.shape, 2.0), 3.0)
        assert found.extreme == pytest.approx(35.0, abs=1.2 if fwhm == 2 else 0.3)  # the highest pixel may be 3.8 °C too low
        assert found.area_px == pytest.approx(math.pi * fwhm**2 / 4, rel=0.2 if fwhm == 2 else 0.05)


def test_spots_side_by_side_are_two_and_weak_ones_are_none() -> None:
    image = wall((30, 40, 10.0, 3.0), (30, 55, 8.0, 3.0), (60, 80, 2.5, 4.0))
    assert [r.peak for r in regions_by_excess(image, SLANTED, 3.0)] == [(30, 40), (30, 55)]
    assert [r.peak for r in regions_by_excess(-image, SLANTED, 3.0)] == []


def test_a_line_is_one_region() -> None:
    image = 20 + 10 * np.exp(-4 * math.log(2) * (Y - 40) ** 2 / 9) * (np.abs(X - 60) < 12)
    (found,) = regions_by_excess(image, np.full(image.shape, 2.0), 3.0)
    assert np.ptp(found.columns) == 22 and np.ptp(found.rows) == 2


def test_edges_and_large_areas_do_not_stand_out() -> None:
    image = 20 + 20 * ((X > 60) & (Y > 30))  # a corner of a radiator
    assert not regions_by_excess(image, np.full(image.shape, 2.0), 3.0)


def test_a_warm_thing_in_front_of_a_wall_is_no_spot_of_the_wall() -> None:
    mug = np.hypot(Y - 45, X - 60) < 4
    image, depth = np.where(mug, 50.0, 20.0), np.where(mug, 1.5, 2.0)
    assert not regions_by_excess(image, depth, 3.0)
    assert len(regions_by_excess(image, np.full(image.shape, 2.0), 3.0)) == 1


def test_areas_beyond_a_threshold() -> None:
    image = wall((30, 40, 10.0, 3.0)) + 20 * ((X > 90) & (Y > 50))
    first, second = sorted(regions_by_threshold(image, SLANTED, 27.0), key=lambda r: len(r.rows))
    assert first.peak == (30, 40) and first.surroundings == pytest.approx(21.0, abs=1.0)
    assert len(second.rows) == 29 * 39
    assert not list(regions_by_threshold(image, np.full(image.shape, np.nan), 27.0))


def test_sharp_edges_raise_no_peak() -> None:
    """A plate of one temperature is as warm as its pixels; and what is cold beside a spot does not make the spot warmer."""
    plate = 20 + 28.0 * ((np.abs(Y - 40) < 5) & (np.abs(X - 60) < 4))
    (found,) = regions_by_excess(plate, np.full(plate.shape, 2.0), 3.0)
    assert found.extreme == pytest.approx(48.0, abs=1.0)
    spot = wall((40, 60, 10.0, 2.0))
    beside = np.where(X < 57, spot - 40, spot)  # a window, far colder
    (alone,), (edged,) = (regions_by_excess(image, np.full(image.shape, 2.0), 3.0) for image in (spot, beside))
    assert edged.extreme == pytest.approx(alone.extreme, abs=0.5)


def test_the_top_of_a_wide_spot_lies_between_its_pixels() -> None:
    fine = (np.arange(8 * 41) + 0.5) / 8 - 0.5
    y, x = fine[:, None] - 20.5, fine[None] - 20.4
    spot = 20 + 15 * np.exp(-4 * math.log(2) * (x**2 + y**2) / 6.0**2)
    image = spot.reshape(41, 8, 41, 8).mean(axis=(1, 3))
    rows, columns = np.nonzero(image > 27.5)
    assert highest(image, rows, columns, 20.0) == pytest.approx(35.0, abs=0.1) and image.max() < 34.4
