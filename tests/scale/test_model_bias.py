"""What the RGB model does to a rig by itself, seen from its own photographs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.scale_scenes import GLOBAL, RIG, spiral

from rtgs.maths.geometry import axis_angle_from_rotation
from rtgs.models import RgbModel
from rtgs.records.scene import Scene
from rtgs.renderer import render
from rtgs.scale.bracket import Bracket
from rtgs.scale.model_bias import model_bias
from rtgs.scale.problem import Problem

pytestmark = pytest.mark.thorough


def photographed(scene: Scene, model: RgbModel, zoom: float) -> Scene:
    """The scene with photographs of the model through a lens that is longer than the scene's records say."""
    rgb = scene.rig.rgb
    camera = replace(rgb, fl_x=zoom * rgb.fl_x, fl_y=zoom * rgb.fl_y)
    frames = []
    for frame in scene.capture.frames:
        view = render(model.gaussians, camera, scene.rgb_from_world(frame.name), settings=model.settings)
        frames.append(replace(frame, rgb=np.clip(view.over(model.background).numpy(), 0.0, 1.0).astype(np.float32)))
    return replace(scene, capture=replace(scene.capture, frames=tuple(frames)))


@pytest.mark.parametrize("zoom", [1.0, 1.01])
def test_a_model_that_is_drawn_too_small_shows_as_another_focal_length(zoom: float) -> None:
    scene, model = spiral(1, RIG, 1.0)
    scene = photographed(scene, model, zoom)
    problem = Problem(scene, model, scene.train_frames, Bracket(math.nan, math.nan), GLOBAL)
    found = model_bias(problem, 2.3, range(0, len(problem.frames), 2))
    # Going forwards looks like zooming, as far as the scene is flat.
    assert found.log_zoom + found.translation[2] / 2.3 == pytest.approx(math.log(zoom), abs=0.002)
    assert np.linalg.norm(axis_angle_from_rotation(found.rotation)) < math.radians(0.3)
