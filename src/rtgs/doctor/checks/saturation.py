"""Thermal pixels at the end of their range."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rtgs.doctor.patient import Patient, some
from rtgs.doctor.records import Finding

_SHARE = 0.01  # of the pixels, at one extreme value
_LEAST = 20  # pixels


def check(patient: Patient) -> list[Finding]:
    """Many pixels have exactly the highest or the lowest count of all images."""
    low = min(float(look.counts.min()) for look in patient.looks)
    high = max(float(look.counts.max()) for look in patient.looks)
    at_end = [
        look.name
        for look in patient.looks
        if look.counts.min() < look.counts.max() and _at_end(look.counts, low, high) > max(_SHARE * look.counts.size, _LEAST)
    ]
    if len(at_end) <= len(patient.looks) / 20:
        return []
    text = f"in {len(at_end)} thermal images a hundredth of the pixels or more is at the end of the range: {some(at_end)}"
    remedy = "Switch the camera to its larger range of temperatures; what is cut off cannot be brought back."
    return [Finding("saturation", "warning", text, remedy)]


def _at_end(counts: NDArray[np.generic], low: float, high: float) -> int:
    return max(int((counts == low).sum()), int((counts == high).sum()))
