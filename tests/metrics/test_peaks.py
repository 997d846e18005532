"""Peak errors: what they count as a peak, and that they see what a mean error overlooks."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from rtgs.metrics.basic import mae
from rtgs.metrics.peaks import APART_PX, MOST, find_peaks, noise_of, peak_errors

SPOTS = [(20, 30, 9.0), (50, 20, -8.0), (45, 70, 6.0), (75, 50, -5.0)]  # row, column, °C


def wall(spots: list[tuple[int, int, float]] = SPOTS, fwhm_px: float = 3.0) -> NDArray[np.float64]:
    """A wall that is warmer at the top, with Gaussian spots."""
    y, x = np.mgrid[:96, :96].astype(float)
    image = 20 + 3 * y / 96
    for row, column, height in spots:
        image += height * np.exp(-4 * np.log(2) * ((y - row) ** 2 + (x - column) ** 2) / fwhm_px**2)
    return image


def noisy(image: NDArray[np.float64], sigma: float = 0.05) -> NDArray[np.float64]:
    return image + sigma * np.random.default_rng(0).standard_normal(image.shape)


@pytest.mark.parametrize("fwhm_px", [2.0, 3.0, 5.0, 8.0])
def test_spots_of_both_signs_are_found_where_they_are(fwhm_px: float) -> None:
    peaks = find_peaks(noisy(wall(fwhm_px=fwhm_px)))
    found = {(r, c): (s, v) for r, c, s, v in zip(peaks.rows, peaks.columns, peaks.signs, peaks.values, strict=True)}
    assert len(found) == len(SPOTS)
    for row, column, height in SPOTS:
        near = [value for at, value in found.items() if np.hypot(at[0] - row, at[1] - column) <= 1.5]
        assert len(near) == 1 and near[0][0] == np.sign(height)
        assert near[0][1] == pytest.approx(20 + 3 * row / 96 + height, abs=0.25)
    assert list(peaks.signs) == [1, 1, -1, -1]
    assert peaks.strengths[0] > peaks.strengths[1] and peaks.strengths[2] > peaks.strengths[3]


def test_noise_has_no_peaks() -> None:
    assert len(find_peaks(noisy(wall([])))) == 0
    assert len(peak_errors(wall([]), noisy(wall([])))) == 0
    assert noise_of(noisy(wall([])), np.ones((96, 96), bool)) == pytest.approx(0.05, rel=0.05)


def test_a_large_warm_area_has_none_and_hides_none() -> None:
    """The radiator is warmer than every spot."""
    image = wall()
    image[5:90, 78:] += 30
    peaks = find_peaks(noisy(image))
    assert {(row, column) for row, column, _ in SPOTS} <= set(zip(peaks.rows.tolist(), peaks.columns.tolist(), strict=True))
    assert not ((peaks.columns >= 76) & (peaks.strengths > 1)).any()


def test_erased_spots_have_a_small_mean_error_and_a_large_peak_error() -> None:
    photograph = noisy(wall())
    erased, kept = wall([]), wall()
    assert mae(erased, photograph) < 0.08 and mae(kept, photograph) < 0.05
    assert peak_errors(erased, photograph).mean() > 6
    assert peak_errors(kept, photograph).max() < 0.3


def test_a_peak_two_pixels_away_is_right_and_one_further_away_is_not() -> None:
    photograph = wall()
    assert peak_errors(np.roll(photograph, 2, axis=1), photograph).max() < 0.2
    assert peak_errors(np.roll(photograph, 6, axis=1), photograph).min() > 4


def test_a_hot_peak_that_is_shown_too_hot_is_an_error_too() -> None:
    (error,) = peak_errors(wall([(40, 40, 12.0)]), wall([(40, 40, 9.0)]))[:1]
    assert error == pytest.approx(3.0)


def test_at_most_ten_of_a_sign_and_well_apart() -> None:
    rng = np.random.default_rng(1)
    spots = [(int(r), int(c), float(h)) for r, c, h in zip(*rng.integers(3, 93, (2, 60)), rng.uniform(2, 9, 60), strict=True)]
    peaks = find_peaks(wall(spots))
    hot = peaks.signs > 0
    assert hot.sum() == MOST
    at = np.stack([peaks.rows, peaks.columns], axis=1)[hot]
    apart = np.linalg.norm(at[:, None] - at[None], axis=-1)[~np.eye(MOST, dtype=bool)]
    assert apart.min() >= APART_PX


def test_masked_pixels_change_nothing() -> None:
    photograph, render = noisy(wall()), wall([])
    mask = np.ones(photograph.shape, bool)
    mask[:, 55:] = False
    spoilt, nan = photograph.copy(), render.copy()
    spoilt[:, 55:], nan[:, 55:] = 500.0, np.nan
    errors = peak_errors(nan, spoilt, mask=mask)
    assert len(errors) == 2  # those at columns 30 and 20; around the one at column 50 pixels are missing
    np.testing.assert_array_equal(errors, peak_errors(render, photograph, mask=mask))
    mask[:, 5:] = False
    assert not len(find_peaks(photograph, mask=mask))  # nowhere is the ring around a pixel whole
