"""How many pairs there are, of which sizes."""

from __future__ import annotations

from rtgs.doctor.patient import Patient
from rtgs.doctor.records import Finding

_FEW = 12  # pairs: one in eight is held out, and each part of the scene should be seen several times


def check(patient: Patient) -> list[Finding]:
    """Few pairs; else their number and sizes."""
    capture = patient.capture
    n, rgb, thermal = len(capture.frames), capture.raw_rig.rgb, capture.raw_rig.thermal
    text = f"{n} pairs, RGB {rgb.width}×{rgb.height}, thermal {thermal.width}×{thermal.height} in {capture.radiometry.unit}"
    found = [Finding("frames", "note", text)]
    if n < _FEW:
        found.append(Finding("frames", "warning", f"there are only {n} pairs", "Take a few dozen pairs from different places."))
    return found
