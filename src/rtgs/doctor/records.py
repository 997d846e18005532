"""What an examination finds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

Level = Literal["note", "warning", "error"]


@dataclass(frozen=True)
class Finding:
    """One thing that a check has to say.

    Attributes:
        check: the name of the check.
        level: "note" (a number to know), "warning" (results will suffer) or "error" (there will be none).
        text: a sentence with the figures. remedy: what to change, now or at the next capture; "" for a note.
    """

    check: str
    level: Level
    text: str
    remedy: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """All findings about a capture, errors first.

    Attributes:
        capture: its folder.
        findings: of all checks.
    """

    JSON_PROPERTIES: ClassVar[tuple[str, ...]] = ("verdict",)

    capture: Path
    findings: tuple[Finding, ...]

    def of(self, level: Level) -> tuple[Finding, ...]:
        """The findings of one level."""
        return tuple(f for f in self.findings if f.level == level)

    @property
    def verdict(self) -> Literal["good", "doubtful", "unusable"]:
        """ "unusable" with an error, "doubtful" with a warning."""
        return "unusable" if self.of("error") else "doubtful" if self.of("warning") else "good"
