"""Examine a capture."""

from __future__ import annotations

from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.doctor.patient import Patient
from rtgs.doctor.records import Diagnosis, Finding
from rtgs.doctor.registry import CHECKS
from rtgs.io.capture import load_capture
from rtgs.records.capture import Capture

_LEVELS = ("error", "warning", "note")


def examine(capture: Path | str | Capture, *, progress: Progress | None = None) -> Diagnosis:
    """What can be said of a capture before any work. Nothing is changed.

    Args:
        capture: a folder; or a capture that has been loaded, whose own warnings are then not repeated.
        progress: called with (checks done, checks in all, name).

    Returns:
        A diagnosis. What keeps the folder from being loaded is its one error; all other checks need the images.
    """
    if isinstance(capture, Capture):
        return _diagnosis(capture, (), progress)
    root = Path(capture)
    try:
        loaded = load_capture(root)
    except RtgsError as error:
        return Diagnosis(root, (Finding("loading", "error", str(error), "Correct it, and call again."),))
    return _diagnosis(loaded, tuple(Finding("loading", "warning", text) for text in loaded.warnings), progress)


def _diagnosis(capture: Capture, said: tuple[Finding, ...], progress: Progress | None) -> Diagnosis:
    patient, found = Patient(capture), list(said)
    for done, (name, check) in enumerate(CHECKS.items()):
        if progress is not None:
            progress(done, len(CHECKS), name)
        found += check(patient)
    if progress is not None:
        progress(len(CHECKS), len(CHECKS), "")
    return Diagnosis(capture.root, tuple(sorted(found, key=lambda f: _LEVELS.index(f.level))))
