"""Laws of SE3, Sim3 and quaternions, over seeds and near the identity."""

from __future__ import annotations

import numpy as np
import pytest

from rtgs.maths.geometry import (
    SE3,
    Sim3,
    is_rotation,
    look_at,
    nearest_rotation,
    quat_from_rotation,
    rotation_from_axis_angle,
    rotation_from_quat,
)

SEEDS = range(5)
ANGLES_RAD = (0.0, 1e-9, 1e-4, 1.0, np.pi - 1e-6, np.pi)


def random_sim3(rng: np.random.Generator) -> Sim3:
    pose = random_se3(rng)
    return Sim3(float(rng.uniform(0.1, 10.0)), pose.rotation, pose.translation)


def random_se3(rng: np.random.Generator, angle_rad: float | None = None) -> SE3:
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    angle = rng.uniform(0, np.pi) if angle_rad is None else angle_rad
    return SE3(rotation_from_axis_angle(axis * angle), rng.normal(size=3))


@pytest.mark.parametrize("angle_rad", ANGLES_RAD)
@pytest.mark.parametrize("seed", SEEDS)
def test_inverse(seed: int, angle_rad: float) -> None:
    a_from_b = random_se3(np.random.default_rng(seed), angle_rad)
    np.testing.assert_allclose((a_from_b @ a_from_b.inverse()).matrix(), np.eye(4), atol=1e-12)
    np.testing.assert_allclose((a_from_b.inverse() @ a_from_b).matrix(), np.eye(4), atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_composition_is_associative_and_acts_on_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = (random_se3(rng) for _ in range(3))
    np.testing.assert_allclose(((a @ b) @ c).matrix(), (a @ (b @ c)).matrix(), atol=1e-12)
    points = rng.normal(size=(4, 7, 3))
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=1e-12)
    np.testing.assert_allclose((a @ SE3.identity()).matrix(), a.matrix(), atol=0)


@pytest.mark.parametrize("seed", SEEDS)
def test_matrix_and_torch_round_trips(seed: int) -> None:
    torch = pytest.importorskip("torch")
    a = random_se3(np.random.default_rng(seed))
    np.testing.assert_array_equal(SE3.from_matrix(a.matrix()).matrix(), a.matrix())
    np.testing.assert_allclose(a.to_torch(torch.float64).inverse().matrix(), a.inverse().matrix(), atol=1e-14)


@pytest.mark.parametrize("seed", SEEDS)
def test_scaling_the_baseline_moves_only_the_translation(seed: int) -> None:
    a = random_se3(np.random.default_rng(seed))
    scaled = a.with_baseline_scaled(3.5)
    np.testing.assert_array_equal(scaled.rotation, a.rotation)
    np.testing.assert_allclose(scaled.translation, 3.5 * a.translation)
    # The optical centre in the other camera's frame scales too: R is not touched, so the inverse's translation is linear in t.
    np.testing.assert_allclose(scaled.inverse().translation, 3.5 * a.inverse().translation, atol=1e-12)


@pytest.mark.parametrize("angle_rad", ANGLES_RAD)
@pytest.mark.parametrize("seed", SEEDS)
def test_quaternion_round_trip(seed: int, angle_rad: float) -> None:
    rotation = random_se3(np.random.default_rng(seed), angle_rad).rotation
    quat = quat_from_rotation(rotation)
    assert quat[0] >= 0
    np.testing.assert_allclose(np.linalg.norm(quat), 1, atol=1e-12)
    np.testing.assert_allclose(rotation_from_quat(quat), rotation, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_quaternion_and_its_multiples_are_one_rotation(seed: int) -> None:
    quat = np.random.default_rng(seed).normal(size=4)
    np.testing.assert_allclose(rotation_from_quat(quat), rotation_from_quat(-2.5 * quat), atol=1e-12)
    np.testing.assert_allclose(rotation_from_quat([1, 0, 0, 0]), np.eye(3))


def test_axis_angle_turns_the_right_way() -> None:
    np.testing.assert_allclose(rotation_from_axis_angle([0, 0, np.pi / 2]) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    quarter = rotation_from_quat([np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)])
    np.testing.assert_allclose(quarter @ [1, 0, 0], [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize("seed", SEEDS)
def test_nearest_rotation_projects(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rotation = random_se3(rng).rotation
    printed = np.round(rotation, 4)
    fixed = nearest_rotation(printed)
    assert is_rotation(fixed, tolerance=1e-12)
    assert np.abs(fixed - rotation).max() < 1e-4
    np.testing.assert_allclose(nearest_rotation(fixed), fixed, atol=1e-12)
    assert is_rotation(nearest_rotation(rng.normal(size=(3, 3))), tolerance=1e-10)


@pytest.mark.parametrize(
    "matrix", [np.diag([1.0, 1.0, -1.0]), 1.01 * np.eye(3), np.full((3, 3), np.nan), np.zeros((3, 3)), np.eye(4)]
)
def test_what_is_no_rotation(matrix: np.ndarray) -> None:
    assert not is_rotation(matrix)


@pytest.mark.parametrize("eye", [(3.0, 0.0, 0.0), (1.0, -2.0, 0.5), (0.0, 0.0, 2.0), (0.0, 0.0, -2.0)])
def test_look_at_puts_the_target_on_the_axis(eye: tuple[float, float, float]) -> None:
    world_from_camera = look_at(eye, (0.0, 0.0, 0.0))
    assert is_rotation(world_from_camera.rotation, tolerance=1e-12)
    target = world_from_camera.inverse().apply(np.zeros(3))
    np.testing.assert_allclose(target, np.array([0.0, 0.0, np.linalg.norm(eye)]), atol=1e-12)


def test_look_at_keeps_up_up() -> None:
    camera_from_world = look_at((3.0, 1.0, 0.5), (0.0, 0.0, 0.0)).inverse()
    above = camera_from_world.apply(np.array([0.0, 0.0, 0.1]))
    assert above[1] < 0  # y points down in the image
    assert abs(above[0]) < 1e-12


@pytest.mark.parametrize("seed", SEEDS)
def test_sim3_inverse(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rigid = random_se3(rng)
    a_from_b = Sim3(float(np.exp(rng.normal())), rigid.rotation, rigid.translation)
    points = rng.normal(size=(6, 3))
    np.testing.assert_allclose(a_from_b.inverse().apply(a_from_b.apply(points)), points, atol=1e-12)
    np.testing.assert_allclose(a_from_b.apply(a_from_b.inverse().apply(points)), points, atol=1e-12)


def test_sim3_scales_distances() -> None:
    a_from_b = Sim3(2.0, rotation_from_axis_angle([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]))
    p, q = np.array([[0.0, 0.0, 0.0], [0.0, 3.0, 4.0]])
    np.testing.assert_allclose(np.linalg.norm(a_from_b.apply(q) - a_from_b.apply(p)), 10.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_similarity_carries_poses_as_it_carries_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a_from_b, b_from_camera, points = random_sim3(rng), random_se3(rng), rng.normal(size=(5, 3))
    a_from_camera = a_from_b.carry(b_from_camera)
    # A point in the camera's frame is in the unit of the world that the camera stands in.
    np.testing.assert_allclose(
        a_from_camera.apply(a_from_b.factor * points), a_from_b.apply(b_from_camera.apply(points)), atol=1e-12
    )
    np.testing.assert_allclose(a_from_b.carry_inverse(a_from_camera).matrix(), b_from_camera.matrix(), atol=1e-12)
    np.testing.assert_allclose(a_from_b.apply_inverse(a_from_b.apply(points)), points, atol=1e-12)
    np.testing.assert_allclose(a_from_b.apply_inverse(points), a_from_b.inverse().apply(points), atol=1e-12)
    np.testing.assert_allclose(a_from_b.in_unit(3.0).apply(points), 3.0 * a_from_b.apply(points), atol=1e-12)


def test_the_way_back_from_a_large_translation_is_exact() -> None:
    points = np.array([[10000000.25, -6000000.5, 3.0]])
    a_from_b = Sim3(0.75, np.eye(3), np.array([10000000.0, -6000000.0, 0.0]))
    np.testing.assert_array_equal(a_from_b.apply_inverse(points), np.array([[0.25, -0.5, 3.0]]) / 0.75)
