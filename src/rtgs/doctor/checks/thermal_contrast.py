"""Whether the thermal images show anything: their range beside their noise."""

from __future__ import annotations

import cv2
import numpy as np

from rtgs.doctor.patient import Patient
from rtgs.doctor.records import Finding

_LEAST_OF_NOISE = 12.0
_LEAST_C = 0.8
_NOISE_OF_DIFFERENCE = 1.4826 / np.sqrt(20.0)  # the Laplacian of white noise has 20 times its variance


def check(patient: Patient) -> list[Finding]:
    """Little contrast; else the range and the noise."""
    unit = patient.capture.radiometry.unit
    ranges, noises = [], []
    for look in patient.looks:
        low, high = np.percentile(look.thermal, (1, 99))
        laplacian = cv2.Laplacian(look.thermal, cv2.CV_32F)
        ranges.append(high - low)
        noises.append(_NOISE_OF_DIFFERENCE * np.median(np.abs(laplacian - np.median(laplacian))))
    usual, noise = float(np.median(ranges)), float(np.median(noises))
    text = f"a thermal image spans {usual:.3g} {unit} (1 to 99 percentile), with noise of about {noise:.2g} {unit}"
    if usual < _LEAST_OF_NOISE * noise or (unit == "°C" and usual < _LEAST_C):
        remedy = "Wait for sun, heating or cooling to make differences, or take a scene with warm and cold things; edges show the scale."
        return [Finding("thermal contrast", "warning", f"{text}: there is little to see", remedy)]
    return [Finding("thermal contrast", "note", text)]
