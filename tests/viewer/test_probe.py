"""What is known about one pixel: place, temperature with its error, and what the photographs show there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.viewed_wall import NAMES, RIG, STD_C, TRUTH, truth_c, wall_eye
from tests.helpers.wall_scene import PLANE_M

from rtgs.models import SensorModel
from rtgs.viewer.contents import Contents
from rtgs.viewer.engine import Engine, Eye
from rtgs.viewer.probe import photographs_of, probe


def test_a_reading_agrees_with_the_truth(contents: Contents, engine: Engine) -> None:
    reading = probe(engine, wall_eye(contents), 50.5, 25.5)
    assert reading is not None and reading.temperature is not None and reading.photographed is not None
    truth = float(truth_c(reading.position))
    assert reading.position[2] == pytest.approx(PLANE_M, rel=0.01)
    assert reading.temperature == pytest.approx(truth, abs=0.2)
    assert reading.photographed == pytest.approx(truth, abs=0.2)
    assert reading.std == pytest.approx(STD_C, rel=0.05)
    assert reading.depth == pytest.approx(PLANE_M, rel=0.02)


def test_views_are_those_that_hold_the_place(contents: Contents, engine: Engine) -> None:
    assert contents.scene is not None
    world = contents.world(np.array([0.05, 0.02, PLANE_M]))
    camera, expected = RIG.thermal, set()
    for name in NAMES:
        place = contents.scene.thermal_from_world(name, TRUTH).apply(world)
        x, y = camera.project(place)
        if 0.5 <= x <= camera.width - 0.5 and 0.5 <= y <= camera.height - 0.5:
            expected.add(name)
    found = photographs_of(engine, world)
    assert {p.frame for p in found} == expected and len(found) > 2
    assert [p.pixels_per_unit for p in found] == sorted((p.pixels_per_unit for p in found), reverse=True)


def test_a_place_behind_the_wall_is_seen_by_none(contents: Contents, engine: Engine) -> None:
    assert photographs_of(engine, contents.world(np.array([0.0, 0.0, 1.5 * PLANE_M]))) == ()


def test_nothing_is_known_beside_the_model(contents: Contents, engine: Engine) -> None:
    away = wall_eye(contents, tilt=3.14)
    assert probe(engine, away, 40.0, 30.0) is None


def test_pixels_at_the_rim_are_read(contents: Contents, engine: Engine) -> None:
    assert contents.scene is not None
    photo = Eye(contents.scene.rig.thermal, contents.scene.world_from_thermal(NAMES[0], TRUTH))
    assert probe(engine, photo, photo.camera.width + 3.0, -1.0) is not None


def test_a_run_without_a_thermal_model_or_scale_still_gives_places(contents: Contents) -> None:
    reading = probe(Engine(replace(contents, thermal=None, scale=None)), wall_eye(contents), 40.5, 30.5)
    assert reading is not None and reading.temperature is None and reading.std is None and reading.photographs == ()
    assert reading.position[2] == pytest.approx(TRUTH * PLANE_M, rel=0.01)  # SfM units


def test_drift_and_pattern_are_taken_off_photographs(contents: Contents, engine: Engine) -> None:
    """Photographs are made as the sensor of a model would show them; without its drift they show the scene again."""
    scene, thermal = contents.scene, contents.thermal
    assert scene is not None and thermal is not None
    rng = np.random.default_rng(0)
    pattern = rng.normal(0, 0.5, (RIG.thermal.height, RIG.thermal.width)).astype(np.float32)
    drifting = replace(thermal, sensor=SensorModel({n: (1.02, 0.3 * i) for i, n in enumerate(NAMES)}, pattern))
    frames = []
    for frame in scene.frames:
        pose = scene.thermal_from_world(frame.name, TRUTH)
        frames.append(frame.with_thermal(drifting.render(RIG.thermal, pose, photographed_in=frame.name)))
    capture = replace(scene.capture, frames=tuple(frames))
    changed = Engine(replace(contents, thermal=drifting, scene=replace(scene, capture=capture)))
    world = contents.world(np.array([0.05, 0.02, PLANE_M]))
    for before, after in zip(photographs_of(engine, world), photographs_of(changed, world), strict=True):
        assert before.frame == after.frame
        assert after.steady == pytest.approx(before.value, abs=0.6)  # between pixels, whose pattern differs
    steady = np.mean(
        [p.steady - q.value for p, q in zip(photographs_of(changed, world), photographs_of(engine, world), strict=True)]
    )
    raw = np.mean([p.value - q.value for p, q in zip(photographs_of(changed, world), photographs_of(engine, world), strict=True)])
    assert abs(steady) < 0.3 < abs(raw)
