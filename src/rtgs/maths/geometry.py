"""Rigid and similarity transforms, and quaternions.

A transform is named `a_from_b` and maps points: `x_a = a_from_b @ x_b`. `SE3` holds NumPy arrays or torch tensors alike: the data
side of the package is NumPy float64, the renderer's side is torch, and one class serves both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = Any  # np.ndarray or torch.Tensor; both answer to `@`, `.T`, `+`, `*`


@dataclass(frozen=True, eq=False)
class SE3:
    """A rigid transform `a_from_b`: `x_a = rotation @ x_b + translation`.

    Attributes:
        rotation: `[3, 3]`, orthonormal with determinant 1.
        translation: `[3]`, in the unit of frame a.
    """

    rotation: Array
    translation: Array

    @staticmethod
    def identity() -> SE3:
        return SE3(np.eye(3), np.zeros(3))

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> SE3:
        """From `[4, 4]` or `[3, 4]`; the last row is not looked at."""
        m = np.asarray(matrix, dtype=np.float64)
        return SE3(m[:3, :3].copy(), m[:3, 3].copy())

    def matrix(self) -> NDArray[np.float64]:
        """`[4, 4]` float64 NumPy matrix (detached, where it holds tensors)."""
        out = np.eye(4)
        out[:3, :3] = _to_numpy(self.rotation)
        out[:3, 3] = _to_numpy(self.translation)
        return out

    def inverse(self) -> SE3:
        rt = self.rotation.T
        return SE3(rt, -(rt @ self.translation))

    def __matmul__(self, other: SE3) -> SE3:
        """`a_from_b @ b_from_c = a_from_c`."""
        return SE3(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)

    def apply(self, points: Array) -> Array:
        """Map points `[..., 3]` from frame b to frame a."""
        return points @ self.rotation.T + self.translation

    def with_baseline_scaled(self, factor: Array) -> SE3:
        """`(R, factor · t)`: Eq. 1's rig transform in SfM units, when `factor` is `sfm_per_metre`."""
        return SE3(self.rotation, factor * self.translation)

    def to_torch(self, dtype: Any = None, device: Any = None) -> SE3:
        """The same transform as torch tensors (float32 by default, and by default on the device where they are)."""
        import torch

        dtype = dtype or torch.float32
        return SE3(*(torch.as_tensor(part).to(device=device, dtype=dtype) for part in (self.rotation, self.translation)))


@dataclass(frozen=True, eq=False)
class Sim3:
    """A similarity `a_from_b`: `x_a = factor · rotation @ x_b + translation`.

    The way back subtracts the translation before anything else. So a point close to a large translation keeps all the digits that it has,
    which `inverse().apply` would round away.
    """

    factor: float
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    @staticmethod
    def identity() -> Sim3:
        return Sim3(1.0, np.eye(3), np.zeros(3))

    def __matmul__(self, other: Sim3) -> Sim3:
        """`a_from_b @ b_from_c = a_from_c`."""
        return Sim3(self.factor * other.factor, self.rotation @ other.rotation, self.apply(other.translation))

    def apply(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map points `[..., 3]` from frame b to frame a."""
        return self.factor * points @ self.rotation.T + self.translation

    def apply_inverse(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map points `[..., 3]` from frame a to frame b."""
        return (points - self.translation) @ self.rotation / self.factor

    def carry(self, b_from_camera: SE3) -> SE3:
        """`a_from_camera`: where a camera stands in frame a, lengths in the unit of frame a."""
        return SE3(self.rotation @ b_from_camera.rotation, self.apply(b_from_camera.translation))

    def carry_inverse(self, a_from_camera: SE3) -> SE3:
        """`b_from_camera`: where a camera stands in frame b, lengths in the unit of frame b."""
        return SE3(self.rotation.T @ a_from_camera.rotation, self.apply_inverse(a_from_camera.translation))

    def in_unit(self, factor: float) -> Sim3:
        """`a_from_b` with a's unit `factor` times smaller: all lengths in a are `factor` times larger."""
        return Sim3(self.factor * factor, self.rotation, self.translation * factor)

    def inverse(self) -> Sim3:
        rt = self.rotation.T
        return Sim3(1.0 / self.factor, rt, -(rt @ self.translation) / self.factor)


def is_rotation(matrix: ArrayLike, tolerance: float = 1e-3) -> bool:
    """Whether `[3, 3]` is orthonormal and right-handed, to `tolerance` in every entry of RᵀR."""
    r = np.asarray(matrix, dtype=np.float64)
    if r.shape != (3, 3) or not np.isfinite(r).all():
        return False
    return bool(np.abs(r.T @ r - np.eye(3)).max() < tolerance and np.linalg.det(r) > 0)


def nearest_rotation(matrix: ArrayLike) -> NDArray[np.float64]:
    """The rotation closest to `[3, 3]` in the Frobenius norm: takes printed digits back to orthonormal."""
    u, _, vt = np.linalg.svd(np.asarray(matrix, dtype=np.float64))
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def rotation_from_quat(quat_wxyz: ArrayLike) -> NDArray[np.float64]:
    """`[3, 3]` from a quaternion `wxyz` `[4]` of any non-zero length."""
    w, x, y, z = np.asarray(quat_wxyz, dtype=np.float64) / np.linalg.norm(np.asarray(quat_wxyz, dtype=np.float64))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quat_from_rotation(rotation: ArrayLike) -> NDArray[np.float64]:
    """Quaternion `wxyz` `[4]`, w ≥ 0, of a rotation `[3, 3]`."""
    r = np.asarray(rotation, dtype=np.float64)
    # Bar-Itzhack: the quaternion is the dominant eigenvector of this symmetric matrix; no branch on the trace.
    k = (
        np.array(
            [
                [r[0, 0] + r[1, 1] + r[2, 2], 0, 0, 0],
                [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], 0, 0],
                [r[0, 2] - r[2, 0], r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0],
                [r[1, 0] - r[0, 1], r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1]],
            ]
        )
        / 3.0
    )
    _, vectors = np.linalg.eigh(k)  # reads the lower triangle
    q = vectors[:, -1]
    return q if q[0] >= 0 else -q


def rotation_from_axis_angle(axis_angle_rad: ArrayLike) -> NDArray[np.float64]:
    """Rodrigues: `[3, 3]` from a rotation vector `[3]` in radians."""
    v = np.asarray(axis_angle_rad, dtype=np.float64)
    angle = float(np.linalg.norm(v))
    if angle < 1e-12:
        return np.eye(3)
    return rotation_from_quat(np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * v / angle]))


def axis_angle_from_rotation(rotation: ArrayLike) -> NDArray[np.float64]:
    """Rotation vector `[3]` in radians, of length up to π: the inverse of `rotation_from_axis_angle`."""
    w, *xyz = quat_from_rotation(rotation)
    axis = np.array(xyz)
    length = float(np.linalg.norm(axis))
    return 2.0 * axis if length < 1e-12 else 2.0 * np.arctan2(length, w) * axis / length


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> SE3:
    """`world_from_camera` (OpenCV axes) of a camera at `eye` that looks at `target`."""
    eye, target, up = (np.asarray(v, dtype=np.float64) for v in (eye, target, up))
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, up)
    if np.linalg.norm(x) < 1e-8:  # looking along `up`
        x = np.cross(z, np.roll(up, 1))
    x /= np.linalg.norm(x)
    return SE3(np.stack([x, np.cross(z, x), z], axis=1), eye)


def _to_numpy(value: Array) -> NDArray[np.float64]:
    if hasattr(value, "detach"):
        value = value.detach().cpu().numpy()
    return np.asarray(value, dtype=np.float64)
