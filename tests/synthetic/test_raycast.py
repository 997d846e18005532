"""The ray caster against the projection formula, and what light and air do to a surface."""

from __future__ import annotations

import numpy as np
import pytest
from tests.helpers.synthetic_captures import project

from rtgs.maths.geometry import look_at
from rtgs.synthetic import SynthConfig, render_rgb, render_thermal
from rtgs.synthetic.meshes import box, sphere
from rtgs.synthetic.model import Light, Material, Model, Part
from rtgs.synthetic.raycast import CompiledModel
from rtgs.synthetic.rig import true_rig

pytest.importorskip("embreex")


def test_a_known_ball_lies_where_the_truth_projects_it() -> None:
    """Both renders against the projection formula, to a few hundredths of a pixel: any half-pixel slip would show."""
    ball = Part(sphere(0.12, 64), Material(), (0.0, 0.0, 0.0), 40.0)
    model = CompiledModel(Model((ball,), (), ambient_c=40.0, background_c=0.0))
    config = SynthConfig(size=96)
    rig = true_rig(config)
    world_from_rgb = look_at((3.1, -2.0, 1.4), (0.3, 0.2, -0.1))
    world_from_thermal = world_from_rgb @ rig.rgb_from_thermal
    dark = 1 - render_rgb(model, rig.rgb, world_from_rgb, 4).mean(axis=-1, dtype=np.float64) ** 2.2
    warm = render_thermal(model, rig.thermal, world_from_thermal, 4).astype(np.float64) / 40.0
    for weight, camera, pose in ((dark, rig.rgb, world_from_rgb), (warm, rig.thermal, world_from_thermal)):
        v, u = np.mgrid[: camera.height, : camera.width] + 0.5
        centroid = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
        # A ball's outline is an ellipse whose centre lies a little outside the projected centre (here under 0.03 px).
        np.testing.assert_allclose(centroid, project(camera, pose, np.zeros(3)), atol=0.06)


def test_light_casts_shadows_and_hidden_surfaces_are_nearer_air_temperature() -> None:
    floor = Part(box((4, 4, 0.1), (0, 0, -0.05)), Material(), (0.8, 0.8, 0.8), 60.0)
    lid = Part(box((1, 1, 0.02), (0, 0, 0.3)), Material(), (0.8, 0.8, 0.8), 60.0)
    above = Light(np.array([[0.0, 0.0, 50.0]]), (1.0, 1.0, 1.0))
    model = CompiledModel(Model((floor, lid), (above,), ambient_c=20.0, occlusion_m=1.0))
    origins = np.array([[-3.0, 0, 1.2], [-3.0, 0, 1.2]])
    targets = np.array([[0.0, 0, 0], [-1.4, 0, 0]])  # under the lid; in the open
    directions = (targets - origins) / np.linalg.norm(targets - origins, axis=1, keepdims=True)
    hits = model.hits(origins, directions)
    np.testing.assert_allclose(hits.surface.world, targets, atol=1e-9)
    np.testing.assert_allclose(hits.surface.normal, [[0, 0, 1], [0, 0, 1]], atol=1e-6)
    shadow, lit = model.radiance(hits, -directions).mean(axis=1)
    assert shadow < 0.4 * lit
    hidden_c, open_c = model.temperature_c(hits)
    assert 20 + 0.6 * 40 - 1e-6 <= hidden_c < open_c - 5
    assert open_c <= 60 + 1e-6


def test_temperatures_are_not_rounded_where_the_background_is_a_whole_number() -> None:
    ball = Part(sphere(0.12, 64), Material(), (0.0, 0.0, 0.0), 30.7)
    model = CompiledModel(Model((ball,), (), ambient_c=30.7, background_c=5))
    rig = true_rig(SynthConfig(size=32))
    image = render_thermal(model, rig.thermal, look_at((3.1, -2.0, 1.4), (0.0, 0.0, 0.0)), 1)
    assert set(np.unique(image)) == {np.float32(5.0), np.float32(30.7)}
