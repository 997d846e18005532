"""The bracket's known answer, and what frames can say."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.scale_scenes import RIG, assembled, facing_walls, wall

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3
from rtgs.scale.bracket import bracket_of, find_bracket, flow_per_unit, information


@pytest.mark.parametrize("depth", [0.004, 5.0, 3000.0])
def test_flow_of_a_wall_is_focal_length_times_baseline_over_depth(depth: float) -> None:
    scene, model = wall(depth)
    flow = flow_per_unit(scene, model)
    assert len(flow) == 44 * 56
    expected = 64.0 * 0.2 / depth
    np.testing.assert_allclose(flow, expected, rtol=1e-5)
    lo, hi = bracket_of(flow, 56)
    assert lo == pytest.approx(0.5 / expected, rel=1e-5)  # half a pixel
    assert hi == pytest.approx(28.0 / expected, rel=1e-5)  # half the image


def test_flow_is_what_pixels_do() -> None:
    # A baseline that also goes forward and a turned camera, against the motion of the projected point itself.
    scene, model = wall(5.0)
    rig = replace(scene.rig, rgb_from_thermal=RIG.rgb_from_thermal)
    scene = assembled([SE3.identity()] * 2, [np.zeros((44, 56), np.float32)] * 2, rig)
    flow = flow_per_unit(scene, model).reshape(44, 56)
    camera, h = rig.thermal, 1e-5
    for i, j in ((3, 5), (50, 40)):
        ray = np.array([(i + 0.5 - camera.cx) / camera.fl_x, (j + 0.5 - camera.cy) / camera.fl_y, 1.0])
        in_rgb = rig.rgb_from_thermal.rotation @ ray
        point = in_rgb * 5.0 / in_rgb[2]  # on the wall
        x, y, z = scene.thermal_from_world("001", h).apply(point)
        moved = np.array([camera.fl_x * x / z + camera.cx, camera.fl_y * y / z + camera.cy]) - (i + 0.5, j + 0.5)
        # Mean depth over a Gaussian as deep as it is thin: the wall is tilted by a twentieth against this camera.
        assert flow[j, i] == pytest.approx(np.linalg.norm(moved) / h, rel=0.01)


def test_a_rig_without_a_baseline_is_refused() -> None:
    with pytest.raises(RtgsError, match="baseline is zero"):
        bracket_of(np.zeros(5), 64)


def test_edges_along_the_flow_and_far_ones_inform_less() -> None:
    near, far = facing_walls(2.0, None, 0.0), facing_walls(8.0, None, 0.0)
    worth = [information(s, m, s.train_frames) for s, m in (near, far)]
    assert worth[0].shape == (7,)
    np.testing.assert_allclose(worth[0] / worth[1], 16.0, rtol=0.3)  # flow squared
    scene, model = near
    along = [np.repeat(np.linspace(0, 1, 44, dtype=np.float32)[:, None], 56, axis=1)] * 2  # level edges, level flow
    level = assembled([SE3.identity()] * 2, along, scene.rig)
    upright = assembled([SE3.identity()] * 2, [np.tile(np.linspace(0, 1, 56, dtype=np.float32), (44, 1))] * 2, scene.rig)
    a, b = (information(s, model, s.train_frames)[0] for s in (level, upright))
    assert a < 1e-6 * b


def test_flow_and_pixel_of_a_bracket() -> None:
    scene, model = wall(5.0)
    bracket = find_bracket(scene, model)
    for s in (bracket.lower, 1.0, bracket.upper):
        theta = math.log(s)
        assert bracket.flow_px(theta) == pytest.approx(0.5 * s / bracket.lower, rel=1e-12)
        # A change of ln s by one "pixel" changes the flow by one pixel, to first order.
        assert bracket.flow_px(theta) * bracket.pixel(theta) == pytest.approx(1.0, rel=1e-12)
