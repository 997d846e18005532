"""One camera's intrinsics as numbers to fit: projection with derivatives, and the fit of one camera alone.

Pixels are those of `rig.json`: the centre of the first one is (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rtgs.base.errors import RtgsError
from rtgs.calibration.checkerboard import Sighting
from rtgs.records.camera import Camera

Array = NDArray[np.float64]

ALL = ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")
# What each model is free in, simplest first: the names of its numbers, and which of `ALL` each moves.
_FREE: dict[str, tuple[tuple[str, ...], ...]] = {
    "SIMPLE_PINHOLE": (("fl_x", "fl_y"), ("cx",), ("cy",)),
    "SIMPLE_RADIAL": (("fl_x", "fl_y"), ("cx",), ("cy",), ("k1",)),
    "PINHOLE": (("fl_x",), ("fl_y",), ("cx",), ("cy",)),
    "RADIAL": (("fl_x", "fl_y"), ("cx",), ("cy",), ("k1",), ("k2",)),
    "OPENCV": tuple((name,) for name in ALL),
}
MODELS = tuple(_FREE)


@dataclass(frozen=True, eq=False)
class View:
    """A board in one picture: points `[n, 3]` in metres, and their pixels `[n, 2]`."""

    points: Array
    pixels: Array


@dataclass(frozen=True, eq=False)
class SingleFit:
    """One camera, fitted alone.

    Attributes:
        model: COLMAP's name. values: `[8]`, in the order of `ALL`.
        poses: `[v, 6]` of the boards: rotation vectors and translations, camera from board.
        residuals: for each view `[n, 2]`, pixels.
        noise_px: standard deviation of a corner, in each direction.
        bic: of the models that were tried, by name; the smallest is chosen.
    """

    model: str
    values: Array
    poses: Array
    residuals: list[Array]
    noise_px: float
    bic: dict[str, float]


def view(points: Array, sighting: Sighting) -> View:
    """A sighting with the board's points, in the pixels of `rig.json`."""
    return View(points[sighting.ids], sighting.pixels + 0.5)


def basis(model: str) -> Array:
    """`[8, k]`: how the free numbers of a model move those in `ALL`."""
    return np.array([[float(name in moved) for moved in _FREE[model]] for name in ALL])


def camera(model: str, size: tuple[int, int], values: Array) -> Camera:
    """The record, of an image of `size` = (width, height)."""
    fl_x, fl_y, cx, cy, k1, k2, p1, p2 = map(float, values)
    return Camera(model, *size, fl_x, fl_y, cx, cy, k1, k2, p1=p1, p2=p2)


def project(values: Array, points: Array) -> tuple[Array, Array, Array]:
    """OpenCV's model of a lens.

    Args:
        values: `[8]`.
        points: `[n, 3]` in camera axes.

    Returns:
        Pixels `[n, 2]`, their derivatives by the points `[n, 2, 3]` and by the values `[n, 2, 8]`.
    """
    fx, fy, cx, cy, k1, k2, p1, p2 = values
    z = points[:, 2]
    x, y = points[:, 0] / z, points[:, 1] / z
    r2 = x * x + y * y
    radial, slope = 1 + k1 * r2 + k2 * r2 * r2, 2 * (k1 + 2 * k2 * r2)  # d radial / dx = slope · x
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    ux = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    uy = slope * x * y + 2 * p1 * x + 2 * p2 * y  # = vx
    vy = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    by_xy = np.stack([np.stack([fx * ux, fx * uy], -1), np.stack([fy * uy, fy * vy], -1)], 1)  # [n, 2, 2]
    by_point = np.concatenate([by_xy / z[:, None, None], -(by_xy @ np.stack([x, y], -1)[..., None]) / z[:, None, None]], axis=2)
    zero, one = np.zeros_like(x), np.ones_like(x)
    by_u = np.stack([u, zero, one, zero, fx * x * r2, fx * x * r2 * r2, fx * 2 * x * y, fx * (r2 + 2 * x * x)], -1)
    by_v = np.stack([zero, v, zero, one, fy * y * r2, fy * y * r2 * r2, fy * (r2 + 2 * y * y), fy * 2 * x * y], -1)
    return np.stack([fx * u + cx, fy * v + cy], -1), by_point, np.stack([by_u, by_v], 1)


def moved(pose: Array, points: Array) -> tuple[Array, Array]:
    """Points `[n, 3]` under a pose `[6]` (rotation vector, translation), and derivatives `[n, 3, 6]` by the pose."""
    rotation, by_vector = cv2.Rodrigues(pose[:3])
    by_rotation = np.einsum("kij,nj->nik", np.asarray(by_vector).reshape(3, 3, 3), points)
    return points @ rotation.T + pose[3:], np.concatenate([by_rotation, np.broadcast_to(np.eye(3), (len(points), 3, 3))], 2)


def fit_single(which: str, views: Sequence[View], size: tuple[int, int], models: Sequence[str] = MODELS) -> SingleFit:
    """Fit one camera to its boards with each model, and choose the model of the smallest Bayesian information criterion.

    Args:
        which: "rgb" or "thermal", for messages.
        size: (width, height).

    Raises:
        RtgsError: no camera fits, as when all boards are seen from one side.
    """
    start = _start(which, views, size)
    best: SingleFit | None = None
    bic: dict[str, float] = {}
    for model in models:
        fit = _fit_model(model, views, *start)
        n, squares = sum(2 * len(v.pixels) for v in views), sum(float((r**2).sum()) for r in fit.residuals)
        bic[model] = n * float(np.log(squares / n)) + (len(_FREE[model])) * float(np.log(n))
        if best is None or bic[model] < bic[best.model]:
            best = fit
    assert best is not None
    return SingleFit(best.model, best.values, best.poses, best.residuals, best.noise_px, bic)


def _start(which: str, views: Sequence[View], size: tuple[int, int]) -> tuple[Array, Array]:
    """Values and poses by OpenCV, without lens terms and with the principal point in the middle."""
    flags = cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    points = [v.points.astype(np.float32) for v in views]
    pixels = [(v.pixels - 0.5).astype(np.float32) for v in views]
    try:
        _, matrix, _, rotations, translations = cv2.calibrateCamera(
            points, pixels, size, np.eye(3), np.zeros(5), flags=flags | cv2.CALIB_FIX_ASPECT_RATIO
        )
    except cv2.error as error:
        raise RtgsError(
            f"{which}: no camera fits these boards ({error.err}). Take pictures of the board from other sides."
        ) from None
    values = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2] + 0.5, matrix[1, 2] + 0.5, 0, 0, 0, 0])
    return values, np.concatenate([np.stack(rotations)[..., 0], np.stack(translations)[..., 0]], axis=1)


def _fit_model(model: str, views: Sequence[View], values: Array, poses: Array) -> SingleFit:
    moves = basis(model)
    k, fixed = moves.shape[1], values * (moves.sum(axis=1) == 0)
    rows = np.cumsum([0, *(2 * len(v.pixels) for v in views)])

    def unpack(x: Array) -> tuple[Array, Array]:
        return moves @ x[:k] + fixed, x[k:].reshape(-1, 6)

    def errors(x: Array) -> Array:
        intrinsics, boards = unpack(x)
        return np.concatenate(
            [(project(intrinsics, moved(b, v.points)[0])[0] - v.pixels).ravel() for b, v in zip(boards, views, strict=True)]
        )

    def slopes(x: Array) -> Array:
        intrinsics, boards = unpack(x)
        out = np.zeros((rows[-1], len(x)))
        for i, (board, v) in enumerate(zip(boards, views, strict=True)):
            points, by_pose = moved(board, v.points)
            _, by_point, by_values = project(intrinsics, points)
            out[rows[i] : rows[i + 1], :k] = (by_values @ moves).reshape(-1, k)
            out[rows[i] : rows[i + 1], k + 6 * i : k + 6 * i + 6] = (by_point @ by_pose).reshape(-1, 6)
        return out

    first = np.concatenate([values @ moves / moves.sum(axis=0), poses.ravel()])
    found = least_squares(errors, first, slopes, method="lm", x_scale="jac", max_nfev=200)
    intrinsics, boards = unpack(found.x)
    parts = [r.reshape(-1, 2) for r in np.split(found.fun, rows[1:-1])]
    spare = max(1, rows[-1] - len(first))
    return SingleFit(model, intrinsics, boards, parts, float(np.sqrt(2 * found.cost / spare)), {})
