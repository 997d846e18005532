"""How far the baseline moves things in the thermal image, and how sure the scale will be."""

from __future__ import annotations

import math

import numpy as np

from rtgs.doctor.disparity import find_disparity
from rtgs.doctor.patient import Patient
from rtgs.doctor.records import Finding, Level
from rtgs.records.metres import NORMAL_95
from rtgs.scale.interval import MODEL_PIXELS

_DEPTHS_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_LEAST_PX = 1.0
_FRAME_PX = 0.08  # scatter of one frame
_REMEDY = "Go nearer, use a longer baseline, or bring another source of metres: GPS, a known distance, a board."


def check(patient: Patient) -> list[Finding]:
    """A table over distance, and the flow that the images show."""
    rig = patient.capture.rig
    if rig.start is not None:
        return [Finding("flow", "note", "the rig is not known yet, and so is not by how much its baseline moves things")]
    x, y, z = rig.rgb_from_thermal.rotation.T @ rig.rgb_from_thermal.translation
    speed = max(float(np.hypot(x, y)) * rig.thermal.fl_x, abs(float(z)) * rig.thermal.width / 4)
    table = ", ".join(f"{_three_digits(speed / depth)} px at {depth:g} m" for depth in _DEPTHS_M)
    found = [Finding("flow", "note", f"the baseline moves things in the thermal image by {table}")]
    seen = find_disparity(patient.looks, rig)
    if not seen.clear:
        text = "RGB and thermal edges meet at no common distance before a model is there, so the expected interval is not known"
        return [*found, Finding("flow", "note", text)]
    if seen.flow_px < _LEAST_PX:
        text = "the edges of RGB and thermal images meet as if the baseline were zero: it moves what is seen by less than a pixel"
        return [*found, Finding("flow", "warning", f"{text}, so that the scale cannot be seen", _REMEDY)]
    half = half_width(seen.flow_px, len(patient.capture.frames), patient)
    text = f"the baseline moves most of what is seen by about {seen.flow_px:.0f} px, so things are about {speed / seen.flow_px:.2g} m away"
    text += f"; expected 95 % interval of the scale: ± {100 * half:.2g} %, if rig.json is right"
    level: Level = "warning" if half > 0.1 else "note"
    return [*found, Finding("flow", level, text, _REMEDY if level == "warning" else "")]


def _three_digits(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def half_width(flow_px: float, frames: int, patient: Patient) -> float:
    """Half the expected 95 % interval of ln s, as `rtgs.scale.interval` makes it up."""
    std = patient.capture.rig.calibration_std
    length = std.baseline_length if std else 0.0
    turned = std.rotation_rad * patient.capture.rig.thermal.fl_x if std else 0.0
    pixels = math.hypot(MODEL_PIXELS, _FRAME_PX / math.sqrt(frames), turned)
    return NORMAL_95 * math.hypot(pixels / flow_px, length)
