"""The checks, in the order in which they are made."""

from __future__ import annotations

from rtgs.doctor.checks import (
    calibration,
    effort,
    exposure,
    flow,
    frames,
    metres,
    orientation,
    overlap,
    palette,
    saturation,
    sharpness,
    shutter,
    thermal_contrast,
    times,
)
from rtgs.doctor.patient import Check

CHECKS: dict[str, Check] = {
    "frames": frames.check,
    "times": times.check,
    "orientation": orientation.check,
    "sharpness": sharpness.check,
    "exposure": exposure.check,
    "overlap": overlap.check,
    "thermal contrast": thermal_contrast.check,
    "saturation": saturation.check,
    "shutter": shutter.check,
    "palette": palette.check,
    "calibration": calibration.check,
    "flow": flow.check,
    "metres": metres.check,
    "effort": effort.check,
}
