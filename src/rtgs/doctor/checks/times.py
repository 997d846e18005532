"""When the photographs were taken: gaps, and pairs that were not taken together."""

from __future__ import annotations

import numpy as np

from rtgs.doctor.patient import Patient, some
from rtgs.doctor.records import Finding

_GAP = 20.0  # usual intervals
_LEAST_GAP_S = 60.0
_APART_S = 1.0  # EXIF's whole seconds


def check(patient: Patient) -> list[Finding]:
    """Long pauses, and thermal images whose delay changes."""
    found, rgb, thermal = [], patient.rgb_headers, patient.thermal_headers
    names, times = list(patient.rgb_files), np.array([np.nan if h.time_s is None else h.time_s for h in rgb])
    if not np.isnan(times).any() and len(times) > 2:
        steps = np.diff(times)
        usual = float(np.median(np.abs(steps)))
        long = [names[i + 1] for i in np.flatnonzero(np.abs(steps) > max(_GAP * usual, _LEAST_GAP_S))]
        if long:
            text = f"there are pauses of a minute or more before {some(long)}, and {usual:.0f} s are usual"
            remedy = "Take a scene in one go: temperatures change meanwhile, and so does the thermal camera."
            found.append(Finding("times", "warning", text, remedy))
        if (steps < 0).any():
            text = f"{int((steps < 0).sum())} photographs are older than the one before them in name order"
            found.append(Finding("times", "warning", text, "Name the files in the order in which they were taken."))
    delays = np.array(
        [np.nan if a.time_s is None or b.time_s is None else b.time_s - a.time_s for a, b in zip(rgb, thermal, strict=True)]
    )
    if not np.isnan(delays).any():
        off = np.abs(delays - np.median(delays))
        late = [name for name, o in zip(names, off, strict=True) if o > _APART_S]
        if late:
            text = f"the thermal images of {some(late)} were taken {off.max():.0f} s earlier or later beside their RGB image than usual"
            remedy = "Trigger both cameras together, and check that the files are paired rightly."
            found.append(Finding("times", "warning", text, remedy))
    return found
