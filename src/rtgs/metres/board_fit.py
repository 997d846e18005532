"""A flat target of known size that stands in the scene: its similarity to the frame of the poses, from its points in several images.

1. In the image that shows it largest, the pose of the target is known but for the unit: one number s, SfM units per metre.
2. That s is searched over: the target, placed by it, must fall where the other images show it.
3. All seven numbers of the similarity are refined together, and images that do not fit are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rtgs.calibration.covariance import Block, covariance
from rtgs.maths.geometry import SE3, rotation_from_axis_angle

Array = NDArray[np.float64]
Orders = Sequence[NDArray[np.intp]]

_SAMPLES = 400
_RANGE = 1e3  # of s around its first guess, to either side
_ROUGH = 0.02  # of a slope: agreement of the search
_WRONG = 4.0  # times the median misfit of an image: it is left out
_LEAST_IMAGES = 2


@dataclass(frozen=True, eq=False)
class TargetView:
    """The target in one image: numbers of its points `[n]`, their rays' slopes `[n, 2]`, and the camera's pose in the given frame."""

    ids: NDArray[np.intp]
    slopes: Array
    pose: SE3


@dataclass(frozen=True, eq=False)
class TargetFit:
    """SfM units per metre, the standard deviation of its logarithm, the images that count, and the misfit as a slope."""

    sfm_per_metre: float
    std_log: float
    images: tuple[str, ...]
    misfit: float


def fit_target(points: Array, orders: Orders, views: Mapping[str, TargetView], guess: float) -> TargetFit | str:
    """The size of a target's metre in SfM units; or why it cannot be found.

    Args:
        points: `[n, 3]`, metres, in the plane z = 0.
        orders: permutations `[n]` of the points that a detector cannot tell apart.
        guess: of SfM units per metre, to three orders of magnitude.
    """
    if len(views) < _LEAST_IMAGES:
        return f"{len(views)} image shows it, and {_LEAST_IMAGES} or more are needed" if views else "no image shows it"
    best = _search(points, orders, views, guess)
    if best is None:
        return "its places in the images do not fit one place in the scene; it has to stand still"
    names = list(views)
    for _ in range(4):
        chosen = {name: _closest_order(points, orders, views[name], best) for name in names}
        best = _refined(points, {name: views[name] for name in names}, chosen, best)
        misfits = {name: _misfit(points[chosen[name]], views[name], best) for name in names}
        typical = float(np.median(list(misfits.values())))
        kept = [name for name in names if misfits[name] <= max(_WRONG * typical, 1e-9)]
        if len(kept) == len(names):
            break
        names = kept
    if len(names) < _LEAST_IMAGES:
        return "its places in the images do not fit one place in the scene; it has to stand still"
    jacobians = [_derivatives(points[chosen[name]], views[name], best) for name in names]
    residuals = [_residual(points[chosen[name]], views[name], best).ravel() for name in names]
    noise = np.sqrt(sum(float(r @ r) for r in residuals) / max(sum(len(r) for r in residuals) - 7, 1))
    noise = max(float(noise), 1e-12)
    pairs = zip(jacobians, residuals, strict=True)
    blocks = [Block(j / noise, np.zeros((len(r), 0)), r / noise) for j, r in pairs]
    return TargetFit(float(np.exp(best[0])), float(np.sqrt(covariance(blocks)[0, 0])), tuple(names), noise)


def _placed(points: Array, numbers: Array) -> Array:
    """Points of the target in the given frame: ln s, a rotation vector and a translation are the seven numbers."""
    return np.asarray(np.exp(numbers[0]) * points @ rotation_from_axis_angle(numbers[1:4]).T + numbers[4:])


def _residual(points: Array, view: TargetView, numbers: Array) -> Array:
    """`[n, 2]`, in slopes; large behind the camera."""
    seen = view.pose.inverse().apply(_placed(points[view.ids], numbers))
    z = np.where(seen[:, 2] > 1e-9, seen[:, 2], 1e-9)
    return np.asarray(np.clip(seen[:, :2] / z[:, None], -1e3, 1e3) - view.slopes)


def _misfit(points: Array, view: TargetView, numbers: Array) -> float:
    return float(np.sqrt((_residual(points, view, numbers) ** 2).mean()))


def _derivatives(points: Array, view: TargetView, numbers: Array) -> Array:
    steps = np.array([1e-6, 1e-6, 1e-6, 1e-6, *[1e-6 * np.exp(numbers[0])] * 3])
    columns = []
    for k, step in enumerate(steps):
        shift = np.eye(7)[k] * step
        ahead, behind = _residual(points, view, numbers + shift), _residual(points, view, numbers - shift)
        columns.append(((ahead - behind) / (2 * step)).ravel())
    return np.stack(columns, axis=1)


def _closest_order(points: Array, orders: Orders, view: TargetView, numbers: Array) -> NDArray[np.intp]:
    return min(orders, key=lambda order: _misfit(points[order], view, numbers))


def _search(points: Array, orders: Orders, views: Mapping[str, TargetView], guess: float) -> Array | None:
    first = max(views.values(), key=lambda v: float(np.ptp(v.slopes, axis=0).prod()))
    others = [v for v in views.values() if v is not first]
    best, error = None, _ROUGH
    for camera_from_target in _poses_in(points, first):
        for s in guess * np.geomspace(1 / _RANGE, _RANGE, _SAMPLES):
            numbers = _numbers_of(first.pose, camera_from_target, float(s))
            misfits = [min(_misfit(points[order], view, numbers) for order in orders) for view in others]
            if (now := float(np.median(misfits))) < error:
                best, error = numbers, now
    return best


def _numbers_of(pose: SE3, camera_from_target: SE3, s: float) -> Array:
    placed = pose @ SE3(camera_from_target.rotation, s * camera_from_target.translation)
    turn = cv2.Rodrigues(placed.rotation)[0].ravel()
    return np.array([np.log(s), *turn, *placed.translation])


def _poses_in(points: Array, view: TargetView) -> list[SE3]:
    """Both poses of a flat target that one image allows."""
    _, turns, shifts, _ = cv2.solvePnPGeneric(points[view.ids], view.slopes, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    return [SE3(cv2.Rodrigues(r)[0], np.asarray(t, dtype=np.float64).ravel()) for r, t in zip(turns, shifts, strict=True)]


def _refined(points: Array, views: Mapping[str, TargetView], chosen: Mapping[str, NDArray[np.intp]], start: Array) -> Array:
    size = np.array([1.0, 1.0, 1.0, 1.0, *[np.exp(start[0])] * 3])

    def residuals(numbers: Array) -> Array:
        return np.concatenate([_residual(points[chosen[name]], view, numbers).ravel() for name, view in views.items()])

    typical = max(float(np.median(np.abs(residuals(start)))), 1e-9)
    found = least_squares(residuals, start, x_scale=size, loss="soft_l1", f_scale=2 * typical)
    return np.asarray(found.x, dtype=np.float64)
