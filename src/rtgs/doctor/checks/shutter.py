"""Thermal images that stand still, and jumps of their level: the shutter of the thermal camera."""

from __future__ import annotations

import itertools

import numpy as np

from rtgs.doctor.patient import Patient, some
from rtgs.doctor.records import Finding

_STILL = 0.15  # of the usual difference between neighbours
_MOVED = 0.5  # of the usual difference, in RGB
_JUMP = 8.0  # times the usual step of the level, and at least:
_LEAST_JUMP = 0.3  # of an image's range


def check(patient: Patient) -> list[Finding]:
    """Nearly frozen images while RGB moves, and jumps of the whole image."""
    looks, found = patient.looks, []
    if len(looks) < 4:
        return []
    pairs = list(itertools.pairwise(looks))
    flat = [look.thermal - np.median(look.thermal) for look in looks]
    warm = np.array([np.abs(b - a).mean() for a, b in itertools.pairwise(flat)])
    grey = np.array([np.abs(b.grey - a.grey).mean() for a, b in pairs])
    still = [
        b.name
        for (_, b), w, g in zip(pairs, warm, grey, strict=True)
        if w < _STILL * np.median(warm) and g > _MOVED * np.median(grey)
    ]
    if still:
        text = f"the thermal images {some(still)} are nearly those before them, and the RGB images have moved on"
        remedy = "The thermal camera stands still while its shutter is closed: wait two seconds after each click, and remove these pairs."
        found.append(Finding("shutter", "warning", text, remedy))
    levels = np.array([np.median(look.thermal) for look in looks])
    steps, span = np.abs(np.diff(levels)), float(np.median([np.ptp(np.percentile(look.thermal, (1, 99))) for look in looks]))
    jumps = [b.name for (_, b), s in zip(pairs, steps, strict=True) if s > max(_JUMP * np.median(steps), _LEAST_JUMP * span)]
    if jumps:
        text = f"the level of the thermal images jumps at {some(jumps)}"
        remedy = "Wait after the shutter has clicked, let the camera warm up, and switch automatic ranges off."
        found.append(Finding("shutter", "warning", text, remedy))
    return found
