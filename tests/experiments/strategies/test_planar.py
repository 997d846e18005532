"""Planar: homographies and warps with known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.helpers.wall_scene import RGB, RIG, THERMAL, wall_scene

from rtgs.base.errors import RtgsError
from rtgs.experiments.strategies.planar import PlanarScene, homography, warp
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.records.camera import Camera
from rtgs.records.rig import Rig


def test_homography_takes_the_plane_from_one_picture_to_the_other() -> None:
    rig = replace(RIG, rgb_from_thermal=SE3(rotation_from_axis_angle([0.02, -0.05, 0.03]), np.array([0.1, 0.04, -0.06])))
    plane_m = 2.5
    points = np.array([[0.3, -0.2, plane_m], [-0.6, 0.5, plane_m], [0.0, 0.0, plane_m], [0.4, 0.6, plane_m]])

    def pixels(camera: Camera, p: NDArray) -> NDArray:
        return np.stack([camera.fl_x * p[:, 0] / p[:, 2] + camera.cx, camera.fl_y * p[:, 1] / p[:, 2] + camera.cy], axis=1)

    seen = np.concatenate([pixels(rig.thermal, points), np.ones((4, 1))], axis=1) @ homography(rig, plane_m).T
    np.testing.assert_allclose(seen[:, :2] / seen[:, 2:], pixels(rig.rgb, rig.rgb_from_thermal.apply(points)), atol=1e-9)


def test_homography_by_hand() -> None:
    """Focal length 100, a baseline of 0.2 m to the right and a plane 4 m ahead: 100 · 0.2 / 4 = 5 pixels."""
    camera = Camera("PINHOLE", 64, 48, 100.0, 100.0, 32.0, 24.0)
    there = homography(Rig(camera, camera, SE3(np.eye(3), np.array([0.2, 0.0, 0.0]))), 4.0)
    np.testing.assert_allclose(there, [[1, 0, 5], [0, 1, 0], [0, 0, 1]], atol=1e-12)


def test_warp_by_whole_pixels_moves_pixels_and_tells_what_is_missing() -> None:
    image = np.random.default_rng(0).normal(size=(6, 8)).astype(np.float32)
    valid = np.ones((6, 8), bool)
    valid[2, 5] = False
    moved, inside = warp(image, valid, np.array([[1.0, 0, 2], [0, 1, -1], [0, 0, 1]]), (6, 8))  # reads at (x + 2, y − 1)
    expected = np.zeros((6, 8), bool)
    expected[1:, :6] = valid[:-1, 2:]
    np.testing.assert_array_equal(inside, expected)
    np.testing.assert_allclose(moved[inside], image[:-1, 2:][expected[1:, :6]], atol=1e-6)


def test_warp_there_and_back() -> None:
    y, x = np.mgrid[: THERMAL.height, : THERMAL.width]
    image = (20 + np.sin(x / 6) + np.cos(y / 5)).astype(np.float32)
    there = homography(replace(RIG, rgb_from_thermal=SE3(rotation_from_axis_angle([0, 0, 0.05]), np.array([0.05, 0, 0.02]))), 2.0)
    size = RGB.height, RGB.width
    rgb, valid = warp(image, np.ones(image.shape, bool), np.asarray(np.linalg.inv(there), np.float64), size)
    back, inside = warp(rgb, valid, there, image.shape)
    assert inside.mean() > 0.8
    np.testing.assert_allclose(back[inside], image[inside], atol=0.02)  # twice bilinear


def test_a_plane_that_leaves_the_view_is_refused() -> None:
    with pytest.raises(RtgsError, match=r"0\.05 m.*of the thermal image"):
        PlanarScene.of(wall_scene()[0], 0.05)
