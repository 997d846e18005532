"""The scores of `benchmarks/hot_spots.py`, on images whose scores are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hot_spot_scores import View, edge_widths, false_spots, shares, shown_of_distractors
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.synthetic.features import ThermalFeature
from rtgs.synthetic.model import Surface

CAMERA = Camera("PINHOLE", 80, 60, 100.0, 100.0, 40.0, 30.0)
SPOT = ThermalFeature(
    kind="spot",
    position_m=(0.0, 0.0, 2.0),
    normal=(0.0, 0.0, -1.0),
    along=(1.0, 0.0, 0.0),
    part=0,
    size_px=8.0,
    fwhm_m=0.16,
    length_m=0.16,
    area_m2=0.02,
    excess_c=15.0,
    sign=1,
    surroundings_c=20.0,
    peak_c=35.0,
    views=("a",),
)
LINE = replace(SPOT, kind="line", fwhm_m=0.06, size_px=3.0, length_m=0.6)
RECTANGLE = replace(SPOT, kind="rectangle", fwhm_m=0.5, size_px=25.0, length_m=0.8)


def seen(feature: ThermalFeature) -> View:
    """A wall of 20 °C at z = 2 with the feature; a pixel is 2 cm."""
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    world = np.stack([(x - 40) * 0.02, (y - 30) * 0.02, np.full(x.shape, 2.0)], axis=-1).reshape(-1, 3)
    n = len(world)
    normals = np.broadcast_to([0.0, 0.0, -1.0], world.shape)
    surface = Surface(world, normals, world, normals, np.zeros((n, 3)), np.zeros(n), np.zeros(n, int))
    plain = np.full(x.shape, 20, np.float32)
    image = plain + feature.excess_at(surface).reshape(x.shape).astype(np.float32)
    return View("a", CAMERA, SE3.identity(), image, image, plain)


@pytest.mark.parametrize("feature", [SPOT, LINE, RECTANGLE], ids=lambda f: f.kind)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_render_with_a_part_of_the_excess_has_that_share(feature: ThermalFeature, sign: int) -> None:
    feature = replace(feature, excess_c=15.0 * sign, sign=sign)
    view = seen(feature)
    for share in (0.0, 0.4, 1.0):
        (found,) = shares([feature], view, view.without + share * (view.with_features - view.without))
        assert (found.centre, found.disk) == pytest.approx((share, share), abs=1e-6)
        assert (found.kind, found.sign, found.size_px) == (feature.kind, sign, feature.size_px)


def test_a_warm_wall_around_an_erased_spot_is_no_share_of_it() -> None:
    """The truth without the feature is what counts, at the same pixels: a render that is off by 1 °C is credited a fifteenth."""
    view = seen(SPOT)
    (found,) = shares([SPOT], view, view.without + 1.0)
    assert found.centre == pytest.approx(1 / 15, rel=0.03)  # the pixel at the centre holds 14.7 °C


def test_features_that_the_view_does_not_see_whole_do_not_count() -> None:
    view = seen(SPOT)
    assert not list(shares([replace(SPOT, views=("b",))], view, view.without))
    assert not edge_widths([replace(RECTANGLE, views=("b",))], view, view.without)


@pytest.mark.parametrize("sigma", [1.0, 1.6])
def test_a_blurred_edge_is_as_wide_as_the_blur(sigma: float) -> None:
    from scipy.ndimage import gaussian_filter

    view = seen(RECTANGLE)
    widths = edge_widths([RECTANGLE], view, gaussian_filter(view.with_features, sigma))
    assert len(widths) == 4
    np.testing.assert_allclose(widths, 2.56 * np.hypot(sigma, 0.4), rtol=0.12)  # pixels and their interpolation blur by 0.4 px


def test_false_spots_are_blobs_far_off_the_truth() -> None:
    view = seen(SPOT)
    render = view.with_features.copy()
    assert false_spots(render, view.with_features) == 0
    render[5, 5:8] += 4  # three pixels
    render[20, 10:12] -= 4  # two are too few
    render[50:55, 50:55] += 2.9  # too little
    assert false_spots(render, view.with_features) == false_spots(render, view.with_features, within_px=2) == 1
    assert false_spots(view.without, view.with_features, within_px=2) == 1  # an erased spot


def test_an_edge_that_is_off_by_a_pixel_is_no_false_spot_within_two() -> None:
    wall = np.full((40, 40), 20, np.float32)
    wall[:, 20:] = 40
    moved = np.roll(wall, 1, axis=1)
    moved[:, 0] = 20
    assert false_spots(moved, wall) == 1 and false_spots(moved, wall, within_px=2) == 0


def test_what_a_distractor_leaves_behind() -> None:
    view = seen(SPOT)
    points = np.array([[0.0, 0.0, 2.0], [0.2, 0.0, 2.0], [0.4, 0.2, 2.0]])
    places = {"train": (points, np.array([15.0, 15.0, 7.5]))}
    visible = {"train": np.array([True, True, False])}
    shown, total = shown_of_distractors(places, view, visible, view.without + 3.0, view.without)
    assert shown / total == pytest.approx(0.2)
