"""The rig that a run found, as a `rig.json` for the next capture of the same two cameras."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.io.rig import write_rig
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.capture import Capture
from rtgs.records.rig import CalibrationStd, Rig
from rtgs.run.folder import RunFolder, refuse_own_folders
from rtgs.scale import ScaleEstimate
from rtgs.scale.records import Freedom, Refinement

_POWERS = {"k1": 2, "k2": 4, "p1": 1, "p2": 1}  # of a slope, in what a lens term moves it by, relative


def write_found_rig(folder: RunFolder, out: Path) -> Rig:
    """Write the rig that the run found, with its uncertainty.

    Returns:
        The rig as written, its cameras with their lenses at the files' resolution.

    Raises:
        RtgsError: the run has found no rig, or does not tell all of it, or `out` lies in the capture.
    """
    scale = folder.read_scale()
    refuse_undecided(folder.path, scale)
    capture = folder.load_capture()
    scene = folder.read_scene(capture)
    refuse_own_folders(folder, scene, out)
    rig = rig_of(scale, scene.capture)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_rig(out, rig, capture.radiometry)
    return rig


def refuse_undecided(run: Path, scale: ScaleEstimate) -> None:
    """Raises `RtgsError` where the run found no rig, or a part of it is not decided."""
    found, refinement = scale.calibration, scale.refinement
    if found is None or refinement is None:
        raise RtgsError(f"{run}: its rig was not found from the capture: rig.json gave one. That file is the calibration.")
    undecided = [freedom.name for freedom in refinement.freedoms if not freedom.decided]
    if not found.baseline_decided:
        undecided.append("length of the baseline")
    if undecided:
        why = "" if scale.ci95 is not None else f" ({scale.reason.rstrip('.')})"
        raise RtgsError(f"{run}: the images do not decide: {', '.join(undecided)}{why}. Take frames with nearer things.")
    if scale.ci95 is None:
        raise RtgsError(f"{run}: the rig that was found is in doubt: {scale.reason}")
    if scale.baseline_m is None and scale.metres_per_sfm is None:
        raise RtgsError(f"{run}: the length of the baseline is not known in metres, and rig.json needs it. {scale.no_metres}")


def rig_of(scale: ScaleEstimate, capture: Capture) -> Rig:
    """The rig that was found, its lenses as they bend, its baseline in metres.

    The baseline is as long as the capture's `rig.json` says, else as the run's metres say.

    Args:
        capture: as it was before its rig was found.

    Raises:
        RtgsError: the thermal camera is a fisheye whose focal length has changed: its lens terms cannot follow.
    """
    refinement, raw = scale.refinement, capture.raw_rig
    assert refinement is not None
    pose = SE3.from_matrix(refinement.rgb_from_thermal)
    length_std = raw.calibration_std.baseline_length if raw.calibration_std else 0.0
    if scale.baseline_m is None:
        assert scale.metres_per_sfm is not None and scale.metres is not None
        metres = scale.sfm_per_metre * scale.metres_per_sfm  # of one unit of the translation
        pose = SE3(pose.rotation, pose.translation * metres)
        length_std = math.hypot(scale.std_log or 0.0, scale.metres.std_log or 0.0)
    thermal = zoomed(raw.thermal, refinement.fl_x / raw.thermal.fl_x, refinement.fl_y / raw.thermal.fl_y)
    return Rig(raw.rgb, thermal, pose, uncertainty_of(refinement, length_std))


def zoomed(camera: Camera, x: float, y: float) -> Camera:
    """The camera with its focal lengths times `x` and `y`, where its images were undistorted with the shorter or longer ones.

    A lens term belongs to a power of the slope of a ray, so it changes by the same power of the zoom.

    Raises:
        RtgsError: a fisheye, whose terms belong to the angle.
    """
    zoom = math.sqrt(x * y)
    if camera.model == "OPENCV_FISHEYE" and abs(zoom - 1) > 1e-9:
        raise RtgsError(
            "the thermal camera is a fisheye, and its focal length was found to be another: its lens terms belong to the old one. "
            "Calibrate the thermal camera with a board (`rtgs calibrate target`)."
        )
    terms = {name: getattr(camera, name) * zoom**power for name, power in _POWERS.items() if camera.model != "OPENCV_FISHEYE"}
    return replace(camera, fl_x=camera.fl_x * x, fl_y=camera.fl_y * y, **terms)


def uncertainty_of(refinement: Refinement, length_std: float) -> CalibrationStd:
    """The posterior in the four numbers of `rig.json`; of several directions, the least certain one.

    Args:
        length_std: of the baseline's length, relative.
    """
    rotations = [f.std for f in refinement.freedoms if f.name.startswith("rotation about ")]
    focal = [f.std for f in refinement.freedoms if f.name == "thermal focal length"]
    return CalibrationStd(
        baseline_length=length_std,
        baseline_direction=_aside(refinement),
        rotation_rad=math.radians(max(rotations)),
        thermal_focal=max(focal) / 100.0,
    )


def _aside(refinement: Refinement) -> float:
    """Standard deviation of the baseline's tip across the baseline, relative to its length."""
    places = [i for i, f in enumerate(refinement.freedoms) if f.name.startswith("baseline's share ")]
    shares: list[Freedom] = [refinement.freedoms[i] for i in places]
    std = np.array([f.std / 100.0 for f in shares])
    correlation = np.array(refinement.correlation)[np.ix_([i + 1 for i in places], [i + 1 for i in places])]
    along = np.array([f.mean for f in shares])
    along = along / np.linalg.norm(along)
    across = np.eye(3) - np.outer(along, along)
    covariance = across @ (correlation * np.outer(std, std)) @ across
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))
