"""Orientation tags that differ from file to file."""

from __future__ import annotations

from collections import Counter

from rtgs.doctor.patient import Patient, some
from rtgs.doctor.records import Finding


def check(patient: Patient) -> list[Finding]:
    """Some photographs were taken with the rig held another way, or the tag is wrong."""
    found = []
    for which, headers in (("rgb", patient.rgb_headers), ("thermal", patient.thermal_headers)):
        counts = Counter(h.orientation for h in headers)
        if len(counts) < 2:
            continue
        usual = counts.most_common(1)[0][0]
        others = [h.path.stem for h in headers if h.orientation != usual]
        text = f"the orientation tags of {which}/ differ: {some(others)} have another one than the rest"
        remedy = "Hold the rig one way and switch the orientation sensor off, or remove the tags where pixels are stored alike."
        found.append(Finding("orientation", "warning", text, remedy))
    return found
