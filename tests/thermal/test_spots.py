"""The list of spots: where they are, how large, how hot, and what the model shows of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.helpers.scene_record import altered
from tests.helpers.wall_with_spots import CAMERA, SFM_PER_METRE, SPOTS, photographed, wall

from rtgs.config import SpotsConfig
from rtgs.maths.geometry import SE3
from rtgs.models import ThermalModel
from rtgs.records.scene import Scene
from rtgs.records.spots import ReferenceTemperature
from rtgs.thermal.spot_places import Sighting, facing_area, joined, meeting_point
from rtgs.thermal.spot_views import Surface
from rtgs.thermal.spots import find_spots


@pytest.fixture(scope="module")
def known() -> tuple[Scene, ThermalModel]:
    model = wall(SPOTS)
    return photographed(model), model


@pytest.mark.thorough
def test_position_area_and_temperature_of_known_spots(known: tuple[Scene, ThermalModel]) -> None:
    scene, model = known
    found = find_spots(scene, model)
    assert [spot.kind for spot in found.spots] == ["hot", "cold"] and found.unit == "°C"
    for spot, ((a, b), height, fwhm) in zip(found.spots, SPOTS, strict=True):
        np.testing.assert_allclose(spot.position_m[:2], [a, b], atol=0.006)
        assert abs(spot.position_m[2]) < 0.025  # slanting views show the front of Gaussians that are 2 cm apart
        assert spot.area_m2 == pytest.approx(math.pi * fwhm**2 / 4, rel=0.1)
        assert spot.extreme == pytest.approx(20 + height, abs=1.0) and spot.surroundings == pytest.approx(20, abs=1.0)
        assert 8 <= spot.views <= spot.seen_by <= len(scene.train_frames) and spot.best_frames[0] in {
            f.name for f in scene.train_frames
        }
        assert spot.modelled == pytest.approx(spot.extreme, abs=1e-3) and not spot.model_differs


@pytest.mark.thorough
def test_a_wall_without_spots_has_none_whatever_the_model_shows(known: tuple[Scene, ThermalModel]) -> None:
    assert find_spots(photographed(wall([])), known[1]).spots == ()


@pytest.mark.thorough
def test_what_stands_in_one_photograph_is_none_and_masked_pixels_are_none(known: tuple[Scene, ThermalModel]) -> None:
    scene, _ = known
    names = [f.name for f in scene.train_frames]
    images = {f.name: f.thermal.copy() for f in scene.frames}
    images[names[0]][20:24, 30:34] += 30  # a reflection
    mask = scene.capture.thermal_mask.copy()
    for name in names:
        images[name][60, 70] = 500  # a bad pixel
    mask[60, 70] = False
    spoilt = altered(scene, thermal=images)
    spoilt = replace(spoilt, capture=replace(spoilt.capture, thermal_mask=mask))
    assert [s.kind for s in find_spots(spoilt, wall(SPOTS)).spots] == ["hot", "cold"]


@pytest.mark.thorough
def test_what_few_of_the_views_show_or_what_changes_with_the_view_is_none(known: tuple[Scene, ThermalModel]) -> None:
    """A place that shines to one side: fewer than half of the views that see it show it, or each shows something else."""
    scene, model = known
    names = [f.name for f in scene.train_frames]
    bare = {f.name: f.thermal for f in photographed(wall([])).frames}
    spotted = {f.name: f.thermal for f in scene.frames}
    some = {n: spotted[n] if n in names[:4] else bare[n] for n in bare}
    assert find_spots(altered(scene, thermal=some), model).spots == ()
    strengths = {n: 0.5 + 0.1 * i for i, n in enumerate(names)}
    shining = {n: bare[n] + strengths.get(n, 1.0) * (spotted[n] - bare[n]) for n in bare}
    assert find_spots(altered(scene, thermal=shining), model).spots == ()


@pytest.mark.thorough
def test_what_the_model_erases_is_listed_and_told(known: tuple[Scene, ThermalModel]) -> None:
    scene, _ = known
    weak = wall([(at, 0.5 * height, fwhm) for at, height, fwhm in SPOTS])
    found = find_spots(scene, weak)
    assert len(found.spots) == 2 and all(spot.model_differs for spot in found.spots)
    hot = found.spots[0]
    assert hot.extreme == pytest.approx(32, abs=1.0) and hot.extreme - hot.modelled == pytest.approx(6.0, abs=0.7)


@pytest.mark.thorough
def test_the_criterion_decides(known: tuple[Scene, ThermalModel]) -> None:
    scene, model = known
    assert [s.kind for s in find_spots(scene, model, SpotsConfig(excess=10.0)).spots] == ["hot"]
    assert [s.kind for s in find_spots(scene, model, SpotsConfig(below=16.0)).spots] == ["cold"]
    both = find_spots(scene, model, SpotsConfig(above=26.0, below=16.0, reference="18"))
    assert [s.kind for s in both.spots] == ["hot", "cold"] and both.reference == ReferenceTemperature("", 18.0)
    assert both.spots[0].area_m2 == pytest.approx(math.pi * 0.12**2 / 4, rel=0.3)  # 26 °C is half of its excess
    assert find_spots(scene, model, SpotsConfig(fewest_views=12)).spots == ()


@pytest.mark.thorough
def test_positions_are_in_the_given_frame_at_any_origin(known: tuple[Scene, ThermalModel]) -> None:
    """Far from the origin the world is another one; the list is not."""
    from rtgs.maths.geometry import Sim3

    scene, model = known
    given = Sim3(1.0, np.eye(3), np.array([5e5, 4e6, 100.0]))
    moved = find_spots(replace(scene, given_from_world=given), model).spots
    for spot, there in zip(find_spots(scene, model).spots, moved, strict=True):
        np.testing.assert_allclose(np.array(there.position_m) - spot.position_m, given.translation / SFM_PER_METRE, atol=1e-6)
        assert there.area_m2 == pytest.approx(spot.area_m2)


def sighting(frame: str, eye_x: float, at: tuple[float, float], *, off: float = 0.0, area: float = 0.001) -> Sighting:
    """From (eye_x, 0, −1.5) to a place of the wall z = 0; the model's depth is wrong by a share `off`."""
    eye, place = np.array([eye_x, 0.0, -1.5]), np.array([*at, 0.0])
    centre: NDArray[np.float64] = eye + (1 + off) * (place - eye)
    return Sighting(frame, 1, eye, centre, np.array([0.0, 0.0, 1.0]), area, 0.005, 12, 30.0, 28.0, 20.0, 30.5, 0.4)


def test_sightings_are_joined_where_their_rays_meet() -> None:
    here, there = (0.1, 0.05), (0.4, -0.2)
    views = [("a", -0.5, 0.03), ("b", 0.0, -0.02), ("c", 0.6, 0.01)]
    some = [sighting(n, x, here, off=off) for n, x, off in views] + [sighting(n, x, there, off=off) for n, x, off in views]
    groups = joined(some)
    assert sorted(sorted(s.frame for s in g) for g in groups) == [["a", "b", "c"]] * 2
    for group, place in zip(groups, (here, there), strict=True):
        np.testing.assert_allclose(meeting_point(group), [*place, 0.0], atol=2e-3)  # although the depths are 1 to 3 % off
    assert joined([]) == []


def test_a_group_does_not_grow_from_one_thing_to_the_next() -> None:
    """Six things in a row, each within the radius of the next; views show two of them each."""
    row = [(0.012 * k, 0.0) for k in range(6)]
    pairs = [("a", 0), ("a", 3), ("b", 1), ("b", 4), ("c", 2), ("c", 5), ("d", 0), ("d", 3), ("e", 1), ("e", 4)]
    eyes = {"a": -0.5, "b": -0.2, "c": 0.0, "d": 0.3, "e": 0.6}
    for group in joined([sighting(name, eyes[name], row[k]) for name, k in pairs]):
        assert len({s.frame for s in group}) == len(group)
        assert np.ptp([s.centre[0] for s in group]) < 0.04  # about twice the radius


def test_depth_errors_of_single_views_do_not_divide_a_place() -> None:
    """Rays of seven views meet; the depths are up to 4 % wrong either way."""
    off = (0.04, 0.03, -0.01, -0.02, 0.0, -0.04, 0.01)
    group = [sighting(str(k), 0.3 * (k - 3), (0.1, 0.05), off=share) for k, share in enumerate(off)]
    assert [len(g) for g in joined(group)] == [7]


def test_the_depth_of_a_region_is_that_of_its_own_surface() -> None:
    """A chair before a wall: what smooths the wall's depth also takes the chair's away."""
    smooth = np.full((8, 8), 4.0)
    surface = Surface(CAMERA, SE3.identity(), smooth, smooth)
    rows, columns = np.array([9, 10]), np.array([9, 9])
    np.testing.assert_array_equal(surface.depth_of(rows, columns, np.array([4.2, 3.9])), [4.0, 4.0])
    np.testing.assert_array_equal(surface.depth_of(rows, columns, np.array([3.0, 3.1])), [3.05, 3.05])


def test_area_and_slant_follow_from_what_the_views_show() -> None:
    """A spot of 0.01 on a wall; the model's normals are half a radian off."""
    wrong = np.array([0.0, 0.5, 0.87])
    eyes = [np.array([x, y, -1.5]) for x in (-1.5, 0.0, 1.5) for y in (-1.5, 0.0, 1.5)]
    one = sighting("a", 0.0, (0.0, 0.0))
    group = [replace(one, eye=eye, area=0.015 / float(np.linalg.norm(eye)), normal=wrong) for eye in eyes]
    found = facing_area(group, np.zeros(3))
    assert np.linalg.norm(found) == pytest.approx(0.01, rel=0.02)
    np.testing.assert_allclose(found / np.linalg.norm(found), [0, 0, -1], atol=0.1)  # towards the cameras


def test_a_view_that_shows_a_part_of_the_spot_does_not_make_it_smaller() -> None:
    eyes = [np.array([x, y, -1.5]) for x in (-1.5, 0.0, 1.5) for y in (-1.5, 0.0, 1.5)]
    one = sighting("a", 0.0, (0.0, 0.0))
    group = [replace(one, eye=eye, area=0.015 / float(np.linalg.norm(eye))) for eye in eyes]
    group[2], group[5] = replace(group[2], area=0.0004), replace(group[5], area=0.0006)  # something stands before it
    assert np.linalg.norm(facing_area(group, np.zeros(3))) == pytest.approx(0.01, rel=0.1)


def test_from_one_side_the_normal_of_the_model_decides() -> None:
    group = [sighting("a", 1.5, (0.0, 0.0), area=0.01 / math.sqrt(2))] * 3
    assert np.linalg.norm(facing_area(group, np.zeros(3))) == pytest.approx(0.01, rel=0.2)


def test_the_area_is_that_at_the_distance_where_rays_meet() -> None:
    near = sighting("a", 0.0, (0.0, 0.0), off=-0.1, area=0.0081)
    assert np.linalg.norm(facing_area([near], np.zeros(3))) == pytest.approx(0.01, rel=1e-6)


def test_two_spots_side_by_side_stay_two() -> None:
    """Beside each other along the way of the cameras, all rays meet; across it, they do not."""
    views = (("a", -0.5), ("b", 0.0), ("c", 0.6))
    for x, y in ((0.045, 0.0), (0.0, 0.045)):
        some = [sighting(n, eye, at) for n, eye in views for at in ((0.0, 0.0), (x, y))]
        assert sorted(len(g) for g in joined(some)) == [3, 3]
    assert len(joined([sighting("a", -0.5, (0.0, 0.0)), sighting("b", 0.0, (0.0, 0.045))])) == 2  # the rays do not meet
    assert (
        len(joined([sighting("a", -0.5, (0.0, 0.0)), sighting("b", 0.0, (0.0, 0.0), off=0.045)])) == 2
    )  # the depths do not agree
    assert len(joined([sighting("a", -0.5, (0.0, 0.0)), sighting("b", 0.0, (0.0, 0.0), off=0.03)])) == 1
