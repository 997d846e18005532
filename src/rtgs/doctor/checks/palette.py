"""Thermal images that may be pictures of temperatures and not temperatures."""

from __future__ import annotations

import numpy as np

from rtgs.doctor.patient import Patient
from rtgs.doctor.records import Finding
from rtgs.records.radiometry import RelativeCounts


def check(patient: Patient) -> list[Finding]:
    """8 bits a pixel: each image stretched to its own range, or coarse steps of temperature."""
    looks = patient.looks
    if any(look.counts.dtype.itemsize > 1 for look in looks):
        return []
    full = float(np.mean([int(look.counts.max()) - int(look.counts.min()) >= 250 for look in looks]))
    if full > 0.8 and not isinstance(patient.capture.radiometry, RelativeCounts):
        text = "the thermal images have 8 bits and each fills the whole range: stretched one by one, a count is no temperature"
        remedy = (
            "Save radiometric files (16 bits), or leave celsius_per_count and unit out of rig.json: then they count as relative."
        )
        return [Finding("palette", "warning", text, remedy)]
    return [Finding("palette", "note", "the thermal images have 8 bits; 16 bits show finer differences")]
