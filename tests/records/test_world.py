"""The world that is computed in: the same at any origin and in any unit, and undone on the way out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.scene_record import scene_of

from rtgs.maths.geometry import SE3, Sim3, look_at
from rtgs.records.camera import Camera
from rtgs.records.capture import SparsePoints
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.records.world import given_from_world, is_far, power_of_two, rounding

CAMERA = Camera("PINHOLE", 4, 3, 4.0, 4.0, 2.0, 1.5)
RIG = Rig(CAMERA, CAMERA, SE3(np.eye(3), np.array([0.1, 0.02, 0.0])))
ORIGIN = np.array([1e7, -6e6, 2e5])


def captured(origin: np.ndarray, unit: float, frames: int = 30) -> Scene:
    """Cameras around a cloud of points, with every position p at unit · p + origin."""
    rng = np.random.default_rng(0)
    given = Sim3(unit, np.eye(3), origin)
    poses = [look_at(rng.normal(size=3) * [3, 3, 1] + [0, 0, 4], rng.normal(size=3) * 0.3) for _ in range(frames)]
    points = SparsePoints(given.apply(rng.normal(size=(200, 3))), np.zeros((200, 3), np.float32))
    return scene_of(RIG, [given.carry(pose) for pose in poses], points=points)


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("far", [False, True])
def test_the_world_does_not_depend_on_origin_and_unit(far: bool, unit: float) -> None:
    plain, moved = captured(np.zeros(3), 1.0).recentred(), captured(ORIGIN if far else np.zeros(3), unit).recentred()
    lost = 4 * np.spacing(1e7) / unit if far else 1e-12  # what float64 cannot hold there
    for name, pose in plain.world_from_rgb.items():
        np.testing.assert_allclose(moved.world_from_rgb[name].translation, pose.translation, rtol=0, atol=lost)
        np.testing.assert_array_equal(moved.world_from_rgb[name].rotation, pose.rotation)
    np.testing.assert_allclose(moved.points.xyz, plain.points.xyz, rtol=0, atol=lost)
    assert moved.extent == pytest.approx(plain.extent, rel=10 * lost)
    assert 1.0 < moved.extent < 4.0


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e4])
def test_the_way_out_gives_what_was_given(unit: float) -> None:
    given = captured(ORIGIN, unit)
    back = given.recentred().as_given()
    assert back.given_from_world.factor == 1.0
    step = np.spacing(1e7)
    for name, pose in given.world_from_rgb.items():
        np.testing.assert_allclose(back.world_from_rgb[name].translation, pose.translation, rtol=0, atol=2 * step)
    np.testing.assert_allclose(back.points.xyz, given.points.xyz, rtol=0, atol=2 * step)


@pytest.mark.parametrize("unit", [1.0, 1e4])
def test_the_steady_scene_is_the_same_to_the_last_bit_at_any_origin_and_unit(unit: float) -> None:
    plain, moved = (captured(o, u).recentred().steady() for o, u in ((np.zeros(3), 1.0), (ORIGIN, unit)))
    for name, pose in plain.world_from_rgb.items():
        np.testing.assert_array_equal(moved.world_from_rgb[name].translation, pose.translation)
    np.testing.assert_array_equal(moved.points.xyz, plain.points.xyz)
    exact = captured(np.zeros(3), 1.0).recentred()
    off = [np.abs(p.translation - exact.world_from_rgb[n].translation).max() for n, p in plain.world_from_rgb.items()]
    assert 0 < max(off) < 2e-6
    assert 0 < np.abs(plain.points.xyz - exact.points.xyz).max() < 1.3e-4


def test_the_grid_is_as_fine_as_the_scene_is_small() -> None:
    """A scene that has no world of its own, as in runs of earlier versions, may have any unit."""
    given = captured(np.zeros(3), 1e-5)
    for name, pose in given.steady().world_from_rgb.items():
        np.testing.assert_allclose(pose.translation, given.world_from_rgb[name].translation, atol=1e-10)
    np.testing.assert_allclose(given.steady().points.xyz, given.points.xyz, atol=1e-8)


def test_a_few_cameras_far_off_do_not_move_the_world() -> None:
    poses = list(captured(np.zeros(3), 1.0).world_from_rgb.values())
    lost = [SE3(np.eye(3), np.array([1e6, 0.0, 0.0])), *poses[1:]]
    a, b = given_from_world(poses), given_from_world(lost)
    assert np.abs(a.translation - b.translation).max() < 0.2 * a.factor
    assert b.factor == pytest.approx(a.factor, rel=0.1)


def test_most_cameras_in_one_place() -> None:
    poses = [SE3(np.eye(3), np.array([x, 0.0, 0.0])) for x in (0, 0, 0, 0, 2.0)]
    assert given_from_world(poses).factor == 2.0
    assert given_from_world(poses[:4]).factor == 1.0


@pytest.mark.parametrize("offset", [0.0, 0.4])
def test_thermal_cameras_stand_where_they_stood(offset: float) -> None:
    """The scale is in SfM units per metre, whatever the world: the thermal camera is the same distance away."""
    given = captured(np.array([500.0, -300.0, 20.0]), 7.0)
    given = replace(given, capture=replace(given.capture, rig=replace(RIG, time_offset=offset)))
    scene = given.recentred()
    for name in given.world_from_rgb:
        there = scene.given_from_world.carry(scene.world_from_thermal(name, 2.5))
        np.testing.assert_allclose(there.matrix(), given.world_from_thermal(name, 2.5).matrix(), atol=1e-9)
    assert scene.world_per_metre(2.5) == pytest.approx(2.5 / scene.given_from_world.factor)


def test_the_digits_that_positions_have() -> None:
    centres = np.random.default_rng(0).normal(size=(20, 3)) + 5e6
    assert rounding(centres) == pytest.approx(2.0**-31)
    assert rounding(centres.astype(np.float32).astype(np.float64)) == 0.25


def test_powers_of_two() -> None:
    assert [power_of_two(v) for v in (1.0, 1.3, 0.9, 3.0, 1e-4, 0.0)] == [1.0, 1.0, 1.0, 4.0, 2.0**-13, 1.0]


@pytest.mark.parametrize(("origin", "far"), [(0.0, False), (50.0, False), (1000.0, True)])
def test_far_is_measured_in_spreads_of_the_cameras(origin: float, far: bool) -> None:
    for unit in (1e-4, 1.0):
        given = captured(np.array([origin, 0.0, 0.0]) * unit, unit)
        assert is_far(given_from_world(given.world_from_rgb.values())) == far
