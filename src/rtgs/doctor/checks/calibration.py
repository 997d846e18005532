"""Whether the rig can be right: fields of view, the rotation, the baseline, and EXIF beside rig.json."""

from __future__ import annotations

import math

import numpy as np

from rtgs.doctor.patient import Patient
from rtgs.doctor.records import Finding, Level
from rtgs.maths.geometry import axis_angle_from_rotation

_OVERLAP = 0.3  # of the thermal image inside of the RGB image
_TURN_DEG = 25.0
_CENTRE = 0.2  # of the image's size: principal point off the middle
_ASPECT = 0.1
_BASELINE_M = (0.002, 2.0)
_FAR_M = 1000.0
_REMEDY = "Check rig.json: which way the transform points, metres, pixels of this image size; calibrate again with `rtgs calibrate target`."


def check(patient: Patient) -> list[Finding]:
    """Numbers that no rig has, or that do not fit each other."""
    found, rig = [], patient.capture.rig
    if rig.start is not None:
        text = "rig.json gives no calibrated transform: the rig will be found from the capture, after the RGB model"
        return [Finding("calibration", "note", text)]
    seen = _seen(patient)
    if seen < _OVERLAP:
        level: Level = "error" if seen == 0 else "warning"
        text = f"by rig.json, {100 * seen:.0f} % of the thermal image lies inside of the RGB image, far away"
        found.append(Finding("calibration", level, text, _REMEDY))
    turn = math.degrees(float(np.linalg.norm(axis_angle_from_rotation(rig.rgb_from_thermal.rotation))))
    if turn > _TURN_DEG:
        found.append(Finding("calibration", "warning", f"by rig.json, the two cameras look {turn:.0f}° apart", _REMEDY))
    if rig.baseline_m < _BASELINE_M[0]:
        text = f"the baseline is {1000 * rig.baseline_m:.2g} mm, so that thermal and RGB images hardly differ"
        found.append(Finding("calibration", "warning", text, "Metres then have to come from GPS or a known distance."))
    for which, camera in (("rgb", patient.capture.raw_rig.rgb), ("thermal", patient.capture.raw_rig.thermal)):
        off = max(abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5))
        aspect = abs(camera.fl_x / camera.fl_y - 1)
        if off > _CENTRE or aspect > _ASPECT:
            text = (
                f"{which}: the principal point ({camera.cx:.0f}, {camera.cy:.0f}) and the focal lengths {camera.fl_x:.0f} and "
                f"{camera.fl_y:.0f} are unusual for an image of {camera.width}×{camera.height}"
            )
            found.append(Finding("calibration", "warning", text, _REMEDY))
    return found


def _seen(patient: Patient) -> float:
    """Share of the thermal image that the RGB camera sees, for things far away."""
    rgb, thermal = patient.capture.rig.rgb, patient.capture.rig.thermal
    x, y = np.meshgrid((np.arange(32) + 0.5) / 32 * thermal.width, (np.arange(24) + 0.5) / 24 * thermal.height)
    rays = np.stack([(x - thermal.cx) / thermal.fl_x, (y - thermal.cy) / thermal.fl_y, np.ones_like(x)], axis=-1)
    points = rays @ patient.capture.rig.rgb_from_thermal.rotation.T * _FAR_M
    ahead = points[..., 2] > 0
    pixels = rgb.project(np.where(ahead[..., None], points, 1.0))
    inside = (pixels >= 0).all(axis=-1) & (pixels[..., 0] <= rgb.width) & (pixels[..., 1] <= rgb.height)
    return float((inside & ahead).mean())
