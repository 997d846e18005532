"""Which way is up, from how the cameras were held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.corner_run import GIVEN_FROM_UPRIGHT, corner

from rtgs.io.exports.frames import AXES_FROM_Z_UP, upright
from rtgs.maths.geometry import SE3, look_at
from rtgs.records.scene import Scene

UP = GIVEN_FROM_UPRIGHT.rotation[:, 2]


def held(poses: list[SE3]) -> Scene:
    """The corner's scene with cameras that stand as given, in the upright frame."""
    scene = corner().subject.scene.as_given()
    frames = {f"frame_{i:03d}": GIVEN_FROM_UPRIGHT.carry(pose) for i, pose in enumerate(poses)}
    return replace(scene, world_from_rgb=frames).recentred()


def up_of(scene: Scene) -> np.ndarray:
    found = upright(scene)
    assert found is not None
    return found.rotation.T @ [0.0, 0.0, 1.0]


def test_cameras_around_a_thing() -> None:
    np.testing.assert_allclose(up_of(corner().subject.scene), UP, atol=1e-6)


def test_cameras_that_look_straight_down() -> None:
    poses = [
        SE3(look_at((0, 0, 9), (0.01 * np.cos(a), 0.01 * np.sin(a), 0)).rotation, np.array([a, 0, 9]))
        for a in (0.0, 1.6, 3.1, 4.7)
    ]
    np.testing.assert_allclose(up_of(held(poses)), UP, atol=0.01)


def test_a_hand_that_shakes() -> None:
    rng = np.random.default_rng(0)
    poses = []
    for a in np.arange(0, 6, 0.3):
        eye = np.array([3 * np.cos(a), 3 * np.sin(a), 1.0 + 0.5 * rng.standard_normal()])
        poses.append(look_at(eye, (0, 0, 0), np.array([0, 0, 1]) + 0.05 * rng.standard_normal(3)))
    poses = poses[:8]
    assert np.degrees(np.arccos(up_of(held(poses)) @ UP)) < 3


def test_cameras_in_a_row_do_not_tell() -> None:
    assert upright(held([look_at((x, -5, 1), (x, 0, 1)) for x in np.arange(0, 2, 0.3)])) is None


@pytest.mark.parametrize("axes", AXES_FROM_Z_UP)
def test_every_habit_is_a_rotation(axes: str) -> None:
    turn = AXES_FROM_Z_UP[axes]  # type: ignore[index]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3))
    assert np.linalg.det(turn) == pytest.approx(1)
    up = {"z-up": (0, 0, 1), "y-up": (0, 1, 0), "y-down": (0, -1, 0)}[axes]
    np.testing.assert_allclose(turn @ [0, 0, 1], up)
