"""Blur of the RGB images."""

from __future__ import annotations

import numpy as np

from rtgs.doctor.patient import Patient, some
from rtgs.doctor.records import Finding

_SOFT = 1.7  # `sharpness_of` a picture with a blur of 2 to 3 pixels
_SOFTER = 0.5  # of the usual sharpness above 1


def check(patient: Patient) -> list[Finding]:
    """Pictures that are soft, all of them or some."""
    sharpness = np.array([look.sharpness for look in patient.looks])
    usual = float(np.median(sharpness))
    remedy = "Use a shorter exposure or more light, stand still while the shutter is open, and focus once."
    if usual < _SOFT:
        return [
            Finding("sharpness", "warning", f"the RGB images are soft (sharpness {usual:.1f}, and {_SOFT:g} is little)", remedy)
        ]
    soft = [look.name for look in patient.looks if look.sharpness - 1 < _SOFTER * (usual - 1)]
    if soft:
        return [Finding("sharpness", "warning", f"{len(soft)} RGB images are softer than the others: {some(soft)}", remedy)]
    return []
