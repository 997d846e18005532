"""Exposure of the RGB images."""

from __future__ import annotations

import numpy as np

from rtgs.doctor.patient import Patient, some
from rtgs.doctor.records import Finding

_CLIPPED, _DARK = 0.25, 0.6  # shares of the pixels
_BRIGHT = 0.6  # of what is not clipped: a white background is no overexposure
_CHANGE = 0.35  # of ln brightness, standard deviation of the steps from one frame to the next


def check(patient: Patient) -> list[Finding]:
    """Pictures that are too bright, too dark, or of changing exposure."""
    found, looks = [], patient.looks
    for words, names in (
        ("overexposed", [x.name for x in looks if x.clipped > _CLIPPED and x.rest > _BRIGHT]),
        ("too dark", [x.name for x in looks if x.dark > _DARK]),
    ):
        if len(names) > len(looks) / 10:
            text = f"{len(names)} of {len(looks)} RGB images are {words}: {some(names)}"
            found.append(
                Finding(
                    "exposure",
                    "warning",
                    text,
                    "Set the exposure by hand for the scene; no feature is found where all is one colour.",
                )
            )
    brightness = np.log([max(float(x.grey.mean()), 1e-3) for x in looks])
    if len(looks) > 3 and float(np.diff(brightness).std()) > _CHANGE:
        text = "the exposure of the RGB images changes from one to the next"
        found.append(Finding("exposure", "warning", text, "Lock exposure and white balance."))
    return found
