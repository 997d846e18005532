"""Where the cameras stand: what both of them see."""

from __future__ import annotations

import pytest
from tests.helpers.synthetic_captures import project

from rtgs.config import SceneName
from rtgs.synthetic import SCENES, SynthConfig, compiled_scene, render_thermal
from rtgs.synthetic.camera_path import camera_path
from rtgs.synthetic.rig import true_rig

pytest.importorskip("embreex")


@pytest.mark.thorough
@pytest.mark.parametrize("scene", [s for s in SCENES if s != "room"])
def test_objects_stay_in_both_pictures(scene: SceneName) -> None:
    config = SynthConfig(scene=scene)
    model, rig = compiled_scene(config.scene), true_rig(config)
    for world_from_rgb in camera_path(config, model.model.centre):
        for camera, pose in ((rig.rgb, world_from_rgb), (rig.thermal, world_from_rgb @ rig.rgb_from_thermal)):
            pixels = project(camera, pose, model.points)
            assert pixels.min() > 0 and pixels.max() < camera.width


def test_the_plain_fills_the_picture_and_hides_the_baseline() -> None:
    config = SynthConfig(scene="plain", size=100, frames=12, rig_seed=2)
    model, rig = compiled_scene("plain"), true_rig(config)
    for pose in camera_path(config, model.model.centre):
        image = render_thermal(model, rig.thermal, pose @ rig.rgb_from_thermal, 1)
        assert image.min() > model.model.background_c + 2  # no pixel looks past it
        assert image.max() - image.min() > 10
    flow_px = rig.thermal.fl_x * config.baseline_m / 750
    assert flow_px < 0.05
