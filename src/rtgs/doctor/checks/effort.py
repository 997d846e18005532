"""Memory and time that a run will take."""

from __future__ import annotations

from rtgs.base.memory import GIGABYTE, free_bytes
from rtgs.doctor.patient import Patient
from rtgs.doctor.records import Finding

_USUAL_GB = 4.0
_MINUTES_A_MEGAPIXEL_FRAME = 0.3  # default quality on two cores, as docs/results/arco.md


def check(patient: Patient) -> list[Finding]:
    """A rough estimate."""
    rgb, n = patient.capture.rig.rgb, len(patient.capture.frames)
    minutes = 4 + _MINUTES_A_MEGAPIXEL_FRAME * n * rgb.width * rgb.height / 1e6
    free = free_bytes() / GIGABYTE
    memory = f"up to {min(_USUAL_GB, 0.75 * free):.1f} GB of memory ({free:.1f} GB are free)"
    text = f"a run takes about {minutes:.0f} minutes on two cores, and {memory}"
    return [Finding("effort", "note", text)]
