"""Eq. 1 on the records: only the baseline is scaled, either direction of the rig file is the same rig, and time offsets."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.helpers.scale_scenes import RIG, assembled, sequence, synthetic, with_rig

from rtgs.io.rig import read_rig
from rtgs.maths.geometry import SE3, look_at, rotation_from_axis_angle


@pytest.mark.parametrize("s", [0.0, 0.37, 1.0, 250.0])
def test_only_the_baseline_is_scaled(s: float) -> None:
    scene, _ = synthetic()
    for name, world_from_rgb in scene.world_from_rgb.items():
        pose = scene.world_from_thermal(name, s)
        # The centre of the thermal camera: the RGB camera's, plus s times the baseline seen in the world.
        expected = world_from_rgb.translation + s * world_from_rgb.rotation @ RIG.rgb_from_thermal.translation
        np.testing.assert_allclose(pose.translation, expected, atol=1e-12)
        np.testing.assert_allclose(pose.rotation, world_from_rgb.rotation @ RIG.rgb_from_thermal.rotation, atol=1e-12)
        assert np.linalg.norm(pose.translation - world_from_rgb.translation) == pytest.approx(s * RIG.baseline_m, abs=1e-12)
        np.testing.assert_allclose((scene.thermal_from_world(name, s) @ pose).matrix(), np.eye(4), atol=1e-12)


def test_a_point_seen_by_both_cameras_is_one_point() -> None:
    # A point 2 m before the thermal camera, taken through the rig in metres and through the scene in SfM units.
    s, in_thermal_m = 40.0, np.array([0.3, -0.2, 2.0])
    pose = SE3(rotation_from_axis_angle([0.3, 1.0, -0.4]), np.array([5.0, -3.0, 2.0]))
    scene = assembled([pose], [np.zeros((44, 56), np.float32)])
    through_rgb = pose.apply(s * RIG.rgb_from_thermal.apply(in_thermal_m))
    np.testing.assert_allclose(scene.world_from_thermal("000", s).apply(s * in_thermal_m), through_rgb, atol=1e-10)


def test_either_direction_of_the_rig_file_is_the_same_rig(tmp_path: Path) -> None:
    pinhole = {"model": "PINHOLE", "width": 56, "height": 48, "fl_x": 60.0, "fl_y": 60.0, "cx": 28.0, "cy": 24.0}
    rigs = []
    for key, transform in {
        "rgb_from_thermal": RIG.rgb_from_thermal,
        "thermal_from_rgb": RIG.rgb_from_thermal.inverse(),
    }.items():
        path = tmp_path / f"{key}.json"
        path.write_text(json.dumps({"rgb": pinhole, "thermal": pinhole, key: transform.matrix().tolist()}))
        rigs.append(read_rig(path).rig)
    for rig in rigs:
        np.testing.assert_allclose(rig.rgb_from_thermal.matrix(), RIG.rgb_from_thermal.matrix(), atol=1e-12)
    assert np.abs(RIG.rgb_from_thermal.matrix() - RIG.rgb_from_thermal.inverse().matrix()).max() > 0.1  # the test can tell


def test_time_runs_through_the_neighbours() -> None:
    scene, _ = sequence()
    names = [f.name for f in scene.frames]
    for offset, there in ((1.0, 6), (-1.0, 4), (0.0, 5)):
        pose = with_rig(scene, replace(RIG, time_offset=offset)).world_from_rgb_at_thermal(names[5])
        np.testing.assert_allclose(pose.matrix(), scene.world_from_rgb[names[there]].matrix(), atol=1e-12)
    late = with_rig(scene, replace(RIG, time_offset=0.5))
    middle = late.world_from_rgb_at_thermal(names[5])
    angle = 0.1 * 5.5
    true = look_at([2.6 * math.cos(angle), 2.6 * math.sin(angle), 0.9 * math.sin(0.5 * 5.5)], [0, 0, 0])
    np.testing.assert_allclose(middle.matrix(), true.matrix(), atol=0.01)
    last = late.world_from_rgb_at_thermal(names[-1])  # straight on
    step = scene.world_from_rgb[names[-1]].translation - scene.world_from_rgb[names[-2]].translation
    np.testing.assert_allclose(last.translation, scene.world_from_rgb[names[-1]].translation + 0.5 * step, atol=1e-12)
    gap = replace(late, world_from_rgb={k: v for k, v in scene.world_from_rgb.items() if k not in (names[4], names[6])})
    np.testing.assert_array_equal(gap.world_from_rgb_at_thermal(names[5]).matrix(), scene.world_from_rgb[names[5]].matrix())
