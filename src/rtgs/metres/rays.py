"""From pixels of the RGB files to rays, and to points where rays of several images meet."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera

Array = NDArray[np.float64]
_ROUNDS = 10


def slopes_of(camera: Camera, pixels: Array) -> Array:
    """`[N, 2]`: x/z and y/z of the rays through pixels `[N, 2]` of a camera with its lens."""
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 1, 2) - 0.5
    if camera.model == "OPENCV_FISHEYE":
        flat = cv2.fisheye.undistortPoints(pixels, camera.opencv_matrix, np.array(camera.distortion))
    else:
        lens = np.array([camera.k1, camera.k2, camera.p1, camera.p2])
        flat = cv2.undistortPoints(pixels, camera.opencv_matrix, lens)
    return np.asarray(flat, dtype=np.float64).reshape(-1, 2)


def meeting_point(poses: Sequence[SE3], slopes: Array, std: float) -> tuple[Array, Array] | None:
    """Where the rays of several cameras meet, and its covariance `[3, 3]`.

    Args:
        poses: `frame_from_camera` of each. slopes: `[N, 2]`, of each camera's ray.
        std: standard deviation of a slope.

    Returns:
        None where the rays are parallel, or meet behind a camera.
    """
    cameras = [pose.inverse() for pose in poses]
    rows = [row for c, s in zip(cameras, slopes, strict=True) for row in (c.rotation[:2] - s[:, None] * c.rotation[2])]
    right = [v for c, s in zip(cameras, slopes, strict=True) for v in (s * c.translation[2] - c.translation[:2])]
    point = np.linalg.lstsq(np.stack(rows), np.array(right), rcond=None)[0]
    for _ in range(_ROUNDS):
        residuals, derivatives = [], []
        for camera, slope in zip(cameras, slopes, strict=True):
            x, y, z = camera.apply(point)
            if not z > 0:
                return None
            residuals.append(slope - np.array([x, y]) / z)
            derivatives.append((camera.rotation[:2] - (np.array([x, y]) / z)[:, None] * camera.rotation[2]) / z)
        matrix = np.concatenate(derivatives)
        normal = matrix.T @ matrix
        if np.linalg.cond(normal) > 1e14:
            return None
        point = point + np.linalg.solve(normal, matrix.T @ np.concatenate(residuals))
    return point, std**2 * np.linalg.inv(normal)
