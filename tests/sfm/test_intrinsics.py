"""Structure from motion finds the RGB intrinsics that `rig.json` leaves out, and says how sure they are."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from tests.helpers.photographed_room import NAMES, RGB

from rtgs.config import SfmConfig
from rtgs.io.capture import load_capture
from rtgs.run.folder import RunFolder
from rtgs.sfm.poses import run_sfm

pytestmark = pytest.mark.thorough

CONFIG = SfmConfig(max_features=1000)


def without(root: Path, *fields: str, **more: object) -> None:
    """Remove fields of the RGB camera from `rig.json`, and add others."""
    path = root / "rig.json"
    data = json.loads(path.read_text())
    data["rgb"] = {k: v for k, v in data["rgb"].items() if k not in fields} | more
    path.write_text(json.dumps(data))


def test_focal_length_and_lens_are_found_and_kept_by_the_run(own_room: Path, tmp_path: Path) -> None:
    wrong = math.degrees(2 * math.atan(0.5 * RGB.width / (1.05 * RGB.fl_x)))
    without(own_room, "fl_x", "fl_y", "k1", "k2", "p1", "p2", "width", "height", fov_deg=wrong)
    capture = load_capture(own_room)
    scene = run_sfm(capture, CONFIG)
    assert list(scene.world_from_rgb) == NAMES
    found = scene.capture.found_rgb
    assert found is not None
    values = {v.name: v for v in found.values}
    assert list(values) == ["fl_x", "fl_y", "k1", "k2", "p1", "p2"]
    for name in ("fl_x", "fl_y", "k1"):
        v, true = values[name], getattr(RGB, name)
        assert v.std is not None
        assert abs(v.found - true) < 4 * v.std + 0.002 * abs(true)
    assert values["fl_x"].assumed == pytest.approx(1.05 * RGB.fl_x)
    assert abs(values["fl_x"].found / RGB.fl_x - 1) < 0.02
    # The images are undistorted by the camera that was found, and again when the run goes on.
    assert not np.array_equal(scene.frames[0].rgb, capture.frames[0].rgb)
    run = RunFolder(tmp_path / "run")
    run.path.mkdir()
    run.write_scene(scene, None)
    run.write_summary(scene)
    again = run.read_scene(load_capture(own_room))
    assert again.capture.found_rgb == found
    assert np.array_equal(again.frames[0].rgb, scene.frames[0].rgb)


def test_a_given_focal_length_stays(own_room: Path) -> None:
    without(own_room, "k1", "k2", "p1", "p2")
    found = run_sfm(load_capture(own_room), CONFIG).capture.found_rgb
    assert found is not None
    assert (found.camera.fl_x, found.camera.fl_y) == (RGB.fl_x, RGB.fl_y)
    assert [v.name for v in found.values] == ["k1", "k2", "p1", "p2"]
