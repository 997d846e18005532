"""What is seen from a camera agrees with what is known of a wall."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.helpers.viewed_wall import RIG, STD_C, TRUTH, truth_c, wall_eye
from tests.helpers.wall_scene import PLANE_M

from rtgs.maths.geometry import SE3
from rtgs.viewer.contents import Contents
from rtgs.viewer.engine import Clip, Engine, Eye


def test_a_screen_has_the_angle_of_view_asked_for() -> None:
    camera = Eye.of(200, 100, math.radians(60), SE3.identity()).camera
    assert 2 * math.atan(0.5 * camera.height / camera.fl_y) == pytest.approx(math.radians(60))
    assert (camera.cx, camera.cy, camera.fl_x) == (100, 50, camera.fl_y)


def test_every_modality_is_given_where_asked_for(contents: Contents, engine: Engine) -> None:
    place = wall_eye(contents)
    seen = engine.look(place, rgb=True, temperature=True, depth=True)
    assert seen.rgb is not None and seen.temperature is not None and seen.depth is not None
    assert seen.rgb.shape == (60, 80, 3) and seen.temperature.shape == seen.depth.shape == (60, 80)
    nothing = engine.look(place)
    assert nothing.rgb is None and nothing.temperature is None and nothing.depth is None


def test_depth_and_temperature_are_those_of_the_wall(contents: Contents, engine: Engine) -> None:
    place = wall_eye(contents)
    seen = engine.look(place, temperature=True, depth=True)
    assert seen.depth is not None and seen.temperature is not None
    for x, y in ((20.5, 15.5), (40.5, 30.5), (60.5, 40.5)):
        world = place.world_from_camera.translation + seen.depth[int(y), int(x)] * place.ray(x, y)
        position = contents.position(world)
        assert position[2] == pytest.approx(PLANE_M, rel=0.01)
        assert seen.temperature[int(y), int(x)] == pytest.approx(float(truth_c(position)), abs=0.2)


def test_a_single_ray_finds_the_same_surface(contents: Contents, engine: Engine) -> None:
    place = wall_eye(contents)
    ray = place.ray(30.5, 20.5)
    depth = engine.look(place, depth=True).depth
    assert depth is not None
    assert engine.distance(place, 30.5, 20.5) == pytest.approx(depth[20, 30] * np.linalg.norm(ray), rel=0.005)


def test_the_standard_error_is_that_of_the_gaussians_there(contents: Contents, engine: Engine) -> None:
    assert engine.std(wall_eye(contents), 40.5, 30.5) == pytest.approx(STD_C, rel=0.05)


def test_a_ray_beside_the_wall_meets_nothing(contents: Contents, engine: Engine) -> None:
    away = wall_eye(contents, tilt=math.pi)
    assert math.isnan(engine.distance(away, 40.0, 30.0))
    depth = engine.look(away, depth=True).depth
    assert depth is not None and np.isnan(depth).all()


def test_a_box_hides_what_is_outside(contents: Contents, engine: Engine) -> None:
    lo, hi = contents.box
    middle = 0.5 * (lo[0] + hi[0])
    clip = Clip((middle, -9.0, -9.0), (9.0, 9.0, 9.0))
    place = wall_eye(contents, tilt=0.0)
    whole, part = (engine.look(place, depth=True, clip=c).depth for c in (None, clip))
    assert whole is not None and part is not None
    assert np.isfinite(whole).mean() > 0.9
    assert 0.3 < np.isfinite(part).mean() < 0.7
    assert np.isfinite(part)[:, -10:].all() and np.isnan(part)[:, :10].all()


def test_long_work_lets_pictures_through(contents: Contents, engine: Engine) -> None:
    with engine.holding:
        assert engine.holding.locked()
        steps: list[int] = []
        engine.busy(lambda done, total, text: steps.append(int(engine.holding.locked())))(1, 2, "")
        assert steps == [0] and engine.holding.locked()


def test_positions_are_those_of_the_capture_in_metres(contents: Contents) -> None:
    place = np.array([[0.1, -0.2, 0.7]])
    given = contents.given_from_world.apply(place)
    np.testing.assert_allclose(contents.position(place), given / TRUTH)
    np.testing.assert_allclose(contents.world(contents.position(place)), place)
    assert contents.length_unit == "m" and RIG.baseline_m > 0
