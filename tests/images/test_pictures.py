"""Pictures: known colours, geometry, and that edges are where they should be."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
import pytest
from PIL import Image

from rtgs.images import pictures


def test_to_picture_rounds_clips_and_repeats_gray() -> None:
    out = pictures.to_picture(np.array([[0.0, 0.5, 1.0, 2.0, -1.0, np.nan]]))
    np.testing.assert_array_equal(out[0, :, 0], [0, 128, 255, 255, 0, 0])
    assert out.shape == (1, 6, 3) and (out[..., 0] == out[..., 2]).all()
    with pytest.raises(ValueError, match="picture is made"):
        pictures.to_picture(np.zeros((2, 2, 4)))


def test_palette_ends_middle_and_missing() -> None:
    out = pictures.palette(np.array([[10.0, 30.0, -99.0, 99.0, np.nan, 20.0]]), 10, 30, "gray")
    np.testing.assert_array_equal(out[0, :, 0], [0, 255, 0, 255, pictures.NO_DATA[0], 128])
    hot = np.round(np.array(matplotlib.colormaps["inferno"](1.0)[:3]) * 255)
    np.testing.assert_array_equal(pictures.palette(np.full((1, 1), 5.0), 0, 5)[0, 0], hot)
    for lo, hi in [(1, 1), (2, 1), (0, np.nan)]:
        with pytest.raises(ValueError, match="lo < hi"):
            pictures.palette(np.zeros((2, 2)), lo, hi)
    with pytest.raises(ValueError, match="no colour map"):
        pictures.palette(np.zeros((2, 2)), 0, 1, "infernal")


@pytest.mark.parametrize("height", [20, 120, 512])
@pytest.mark.parametrize(("lo", "hi"), [(10.0, 30.0), (-0.3, 0.3), (20.01, 20.02), (-1500.0, 4000.0)])
def test_colour_bar_stands_beside_the_untouched_picture(height: int, lo: float, hi: float) -> None:
    picture = pictures.palette(np.linspace(lo, hi, height * 30).reshape(height, 30), lo, hi)
    out = pictures.with_colour_bar(picture, lo, hi)
    assert out.dtype == np.uint8 and out.shape[0] == height and out.shape[1] > 30
    np.testing.assert_array_equal(out[:, :30], picture)
    bar = out[:, 30:].astype(int)
    assert (np.abs(bar - np.array(pictures.palette(np.full((1, 1), hi), lo, hi)[0, 0])).sum(axis=2) == 0).any()


@pytest.mark.parametrize(("lo", "hi"), [(10.0, 30.0), (-0.3, 0.3), (20.01, 20.02), (-1500.0, 4000.0), (0, 1), (17.3, 41.9)])
@pytest.mark.parametrize("at_most", [2, 4, 6])
def test_ticks_are_few_even_and_inside(lo: float, hi: float, at_most: int) -> None:
    ticks = pictures._ticks(lo, hi, at_most)
    assert 2 <= len(ticks) <= at_most
    assert ticks[0] >= lo - 1e-9 and ticks[-1] <= hi + 1e-9
    np.testing.assert_allclose(np.diff(ticks), ticks[1] - ticks[0])


def test_ticks_are_the_ones_a_person_would_choose() -> None:
    np.testing.assert_allclose(pictures._ticks(-3, 3, 6), [-2, 0, 2])
    np.testing.assert_allclose(pictures._ticks(18, 41.5, 6), [20, 25, 30, 35, 40])
    assert not np.signbit(pictures._ticks(0, 0.1, 6)).any()


def test_error_map_of_temperatures_is_signed() -> None:
    reference = np.full((40, 20), 25.0)
    too_warm, exact, too_cold = (pictures.error_map(reference + d, reference, 2.0, "°C")[0, 0].astype(int) for d in (2, 0, -2))
    assert too_warm[0] > too_warm[2] and too_cold[2] > too_cold[0]
    assert np.ptp(exact) < 10
    with pytest.raises(ValueError, match="positive"):
        pictures.error_map(reference, reference, 0.0)
    with pytest.raises(ValueError, match="one shape"):
        pictures.error_map(reference, reference[1:], 1.0)


def test_error_map_of_images_is_absolute() -> None:
    a, b = np.full((40, 20, 3), 0.5), np.full((40, 20, 3), 0.4)
    np.testing.assert_array_equal(pictures.error_map(a, b, 0.2), pictures.error_map(b, a, 0.2))
    assert pictures.error_map(a, b, 0.2)[0, 0].sum() > pictures.error_map(a, a, 0.2)[0, 0].sum()


def step(at: int, lo: float = 0.0, hi: float = 1.0) -> np.ndarray:
    image = np.full((40, 60), lo, dtype=np.float32)
    image[:, at:] = hi
    return image


def columns_of(picture: np.ndarray, colour: tuple[int, int, int]) -> set[int]:
    return set(np.nonzero((picture == np.array(colour)).all(axis=2).all(axis=0))[0])


def test_edges_that_meet_are_white_whatever_the_sign_and_unit_of_the_contrast() -> None:
    out = pictures.edge_overlay(step(30), step(30, 35.0, 21.0))
    white = columns_of(out, pictures.COMMON_EDGE)
    assert white and white <= {29, 30}
    assert not columns_of(out, pictures.THERMAL_EDGE) and not columns_of(out, pictures.RENDER_EDGE)


def test_edges_that_miss_each_other_keep_their_colours() -> None:
    out = pictures.edge_overlay(step(20), step(40, 20.0, 21.0))
    assert columns_of(out, pictures.RENDER_EDGE) <= {19, 20} and columns_of(out, pictures.RENDER_EDGE)
    assert columns_of(out, pictures.THERMAL_EDGE) <= {39, 40} and columns_of(out, pictures.THERMAL_EDGE)
    assert not (out == 255).all(axis=2).any()


def test_no_edge_without_contrast_or_at_the_rim_of_the_mask() -> None:
    flat = pictures.edge_overlay(np.full((40, 60), 0.4, np.float32), np.full((40, 60), 20.0, np.float32))
    assert len(np.unique(flat.reshape(-1, 3), axis=0)) == 1
    mask = np.zeros((40, 60), dtype=bool)
    mask[:, :30] = True
    thermal = np.where(mask, 20.0, np.nan).astype(np.float32)  # the rim is a step, but not of the scene
    out = pictures.edge_overlay(np.full((40, 60), 0.4, np.float32), thermal, mask)
    assert len(np.unique(out.reshape(-1, 3), axis=0)) == 1


def test_side_by_side_brings_heights_together() -> None:
    a, b = np.full((50, 40, 3), 10, np.uint8), np.full((100, 30, 3), 200, np.uint8)
    out = pictures.side_by_side([a, b], ["reference", "render"])
    assert out.shape[0] > 100 and out.shape[1] >= 80 + 30
    assert (out[-1, 0] == 10).all() and (out[-1, -1] == 200).all()
    with pytest.raises(ValueError, match="one label"):
        pictures.side_by_side([a], [])


def test_save_png_is_exact_and_leaves_nothing_else(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (9, 7, 3), dtype=np.uint8)
    pictures.save_png(tmp_path / "deep" / "a.png", picture)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "deep" / "a.png")), picture)
    assert [p.name for p in (tmp_path / "deep").iterdir()] == ["a.png"]
