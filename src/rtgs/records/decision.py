"""A choice that a stage takes by itself, with the evidence for it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Decision:
    """What was chosen and why, as it is kept beside the result and shown in the report.

    Attributes:
        name: what was decided about, e.g. "drift".
        choice: what was chosen, in a word or a number, e.g. "offset".
        reason: one sentence for a person.
        error_before, error_after: mean error on validation frames, in `unit`, without and with what was decided about; None where
            nothing was measured (too few frames, or the user chose).
        unit: of the errors, e.g. "°C".
        threshold: relative gain (0.01 for 1 %) from which on the choice is made; None where there is none.
    """

    name: str
    choice: str
    reason: str
    error_before: float | None = None
    error_after: float | None = None
    unit: str = ""
    threshold: float | None = None
