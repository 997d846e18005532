"""From a solution to the records that are written: the rig with its uncertainty, and the calibration's results."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rtgs.calibration.lens import ALL, basis, camera, project
from rtgs.calibration.record import Agreement, CameraResult, PairResult, Rejected, TargetCalibration, Value
from rtgs.calibration.solve import Solution
from rtgs.config.calibration import BoardConfig
from rtgs.maths.geometry import SE3, axis_angle_from_rotation, rotation_from_axis_angle
from rtgs.records.rig import CalibrationStd, Rig

Array = NDArray[np.float64]
_STEP = 1e-6  # of central differences, in radians, metres and relative to focal lengths
Size = tuple[int, int]
Ids = tuple[NDArray[np.intp], NDArray[np.intp]]


def rig_of(solution: Solution, rgb_size: Size, thermal_size: Size) -> Rig:
    """The rig with the uncertainty that refinement and intervals of the scale use."""
    rgb, thermal = (
        camera(m, size, v) for m, size, v in zip(solution.models, (rgb_size, thermal_size), solution.values, strict=True)
    )
    x, cov = _numbers(solution), solution.joint_covariance
    translation = _rgb_from_thermal(x)[3:]
    length = float(np.linalg.norm(translation))
    tip = _propagated(lambda x: _rgb_from_thermal(x)[3:], x, cov)
    along = translation / length
    across = np.eye(3) - np.outer(along, along)
    focal = 0.5 * np.array([1.0, 1.0]) @ cov[8:10, 8:10] @ (0.5 * np.array([1.0, 1.0]))
    std = CalibrationStd(
        baseline_length=float(np.sqrt(along @ tip @ along)) / length,
        baseline_direction=float(np.sqrt(np.linalg.eigvalsh(across @ tip @ across)[-1])) / length,
        rotation_rad=pointing_std_rad(solution, thermal_size),
        thermal_focal=float(np.sqrt(focal)) / float(solution.values[1, :2].mean()),
    )
    matrix = _rgb_from_thermal(x)
    return Rig(rgb, thermal, SE3(rotation_from_axis_angle(matrix[:3]), matrix[3:]), std)


def pointing_std_rad(solution: Solution, thermal_size: Size) -> float:
    """Standard deviation of the place of the thermal image's middle in the RGB image, for a far point, as an angle; or of the roll.

    Rotation and principal points are correlated: what moves one is largely undone by the other. This is what is left.
    """
    x, width, height = _numbers(solution), *thermal_size

    def place(x: Array) -> Array:
        # The thermal ray of this pixel moves with the thermal principal point and focal length; lens terms are small in the middle.
        moved = np.array([(width / 2 - x[10]) / x[8], (height / 2 - x[11]) / x[9], 1.0])
        rotation = rotation_from_axis_angle(x[16:19]).T
        pixel = project(x[:8], (rotation @ moved)[None])[0][0]
        roll = axis_angle_from_rotation(rotation)[2]
        return np.array([pixel[0] / x[0], pixel[1] / x[1], roll])

    return float(np.sqrt(np.diag(_propagated(place, x, solution.joint_covariance)).max()))


def results(config: BoardConfig, solution: Solution, rig: Rig, rejected: dict[str, str], ids: list[Ids]) -> TargetCalibration:
    """The records of `calibration.json`. ids: for each used pair, which points were seen by the RGB and by the thermal camera."""
    x, cov = _numbers(solution), solution.joint_covariance
    std = np.sqrt(np.clip(np.diag(_propagated(_rgb_from_thermal, x, cov)), 0, None))
    pose = _rgb_from_thermal(x)
    assert rig.calibration_std is not None
    names = ["rotation x", "rotation y", "rotation z", "translation x", "translation y", "translation z"]
    factors = [*[float(np.degrees(1.0))] * 3, *[1000.0] * 3]
    values = [
        Value(n, float(v * f), float(s * f), u)
        for n, v, s, f, u in zip(names, pose, std, factors, [*["°"] * 3, *["mm"] * 3], strict=True)
    ]
    values.append(Value("baseline", 1000 * rig.baseline_m, 1000 * rig.baseline_m * rig.calibration_std.baseline_length, "mm"))
    cameras = [_camera_result(solution, i, ids) for i in range(2)]
    pairs = tuple(
        PairResult(n, _rms(a), _rms(b), float(d))
        for n, a, b, d in zip(solution.names, *solution.residuals, solution.disagreement_px, strict=True)
    )
    return TargetCalibration(
        config, cameras[0], cameras[1], tuple(values), float(np.degrees(rig.calibration_std.rotation_rad)), _agreement(solution),
        pairs, tuple(Rejected(n, r) for n, r in sorted((rejected | solution.rejected).items())),
    )  # fmt: skip


def _camera_result(solution: Solution, i: int, ids: list[Ids]) -> CameraResult:
    std = np.sqrt(np.clip(np.diag(solution.joint_covariance), 0, None))[8 * i : 8 * i + 8]
    used = basis(solution.models[i]).sum(axis=1) > 0
    values = tuple(
        Value(n, float(v), float(s), "px" if k < 4 else "")
        for k, (n, v, s) in enumerate(zip(ALL, solution.values[i], std, strict=True))
        if used[k]
    )
    residuals = solution.residuals[i]
    at, which = np.concatenate(residuals), np.concatenate([pair[i] for pair in ids]).astype(int)
    means = np.stack([at[which == k].mean(axis=0) for k in np.unique(which)])
    return CameraResult(solution.models[i], solution.bic[i], values, _rms(at), solution.noise_px[i], _rms(means))


def _agreement(solution: Solution) -> Agreement:
    px, degrees, mm = float(np.median(solution.disagreement_px)), float(np.degrees(solution.turn_rad)), 1000 * solution.shift_m
    if solution.agree:
        sentence = f"The pairs agree on one rigid transform: thermal corners lie {px:.2f} px from where RGB puts them, as noise explains."
    else:
        sentence = (
            f"The pairs do not agree on one rigid transform to better than {px:.1f} px (median over pairs in the thermal image; "
            f"{degrees:.2f}° and {mm:.0f} mm), {solution.ratio:.1f} times what noise explains. Do both cameras fire at one instant? "
            "Are they fixed to each other? Does the board stand still?"
        )
    return Agreement(solution.agree, solution.ratio, px, degrees, mm, sentence)


def _rms(residuals: Array) -> float:
    return float(np.sqrt((residuals**2).sum(axis=-1).mean()))


def _numbers(solution: Solution) -> Array:
    """`[22]`: RGB values, thermal values, rotation vector and translation of `thermal_from_rgb`."""
    return np.concatenate([solution.values.ravel(), solution.rig])


def _rgb_from_thermal(x: Array) -> Array:
    """`[6]`: rotation vector and translation of the inverse."""
    inverse = SE3(rotation_from_axis_angle(x[16:19]), x[19:22]).inverse()
    return np.concatenate([axis_angle_from_rotation(inverse.rotation), inverse.translation])


def _propagated(function: Callable[[Array], Array], x: Array, cov: Array) -> Array:
    """Covariance of a function's values, to first order."""
    steps = _STEP * np.maximum(1.0, np.abs(x))
    slopes = np.stack([(function(x + e) - function(x - e)) / (2 * s) for s, e in zip(steps, np.diag(steps), strict=True)], axis=1)
    return slopes @ cov @ slopes.T
