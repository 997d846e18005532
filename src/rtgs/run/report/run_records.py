"""What the report is made from: the records in a run folder. Every one of them may be missing."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from rtgs.base.json_records import read_record
from rtgs.config import RunConfig
from rtgs.evaluation.records import Evaluation
from rtgs.records.decision import Decision
from rtgs.records.radiometry import Unit
from rtgs.records.spots import SpotList
from rtgs.run.config_file import read_config
from rtgs.run.folder import RunFolder
from rtgs.run.model_files import RgbFile, ThermalFile
from rtgs.run.records import CaptureSummary
from rtgs.scale import ScaleEstimate

T = TypeVar("T")


@dataclass(frozen=True)
class RunRecords:
    """The records of a run folder. A record that no stage has written yet is None.

    Attributes:
        path: the run folder.
        capture: the capture's folder, from `config.json`. settings, version: likewise.
        spots: the list of hot and cold spots, of `rtgs run` or of a later `rtgs spots`.
        decisions: what the stages decided by themselves, from `rgb.json` and `thermal.json`.
        older: stages whose results are of earlier settings or of an earlier capture, and are being made again.
    """

    path: Path
    capture: Path | None
    settings: RunConfig | None
    version: str | None
    summary: CaptureSummary | None
    scale: ScaleEstimate | None
    evaluation: Evaluation | None
    spots: SpotList | None
    decisions: tuple[Decision, ...]
    older: tuple[str, ...] = ()

    @staticmethod
    def read(run: Path) -> RunRecords:
        """Read what is there.

        Raises:
            RtgsError: a file cannot be read, or is not what this version writes.
        """
        rgb = _optional(run / "rgb.json", lambda path: read_record(RgbFile, path))
        thermal = _optional(run / "thermal.json", lambda path: read_record(ThermalFile, path))
        config = _optional(run / "config.json", lambda path: read_config(path.parent))
        return RunRecords(
            path=run,
            capture=config.capture if config else None,
            settings=config.config if config else None,
            version=config.version if config else None,
            summary=_optional(run / "capture_summary.json", CaptureSummary.read),
            scale=_optional(run / "scale.json", lambda path: read_record(ScaleEstimate, path)),
            evaluation=_optional(run / "metrics.json", Evaluation.read),
            spots=_optional(run / "spots" / "spots.json", lambda path: read_record(SpotList, path)),
            decisions=tuple(d for file in (rgb, thermal) if file for d in file.decisions),
            older=_being_made_again(RunFolder(run)),
        )

    @property
    def name(self) -> str:
        """The capture's name, or the run folder's."""
        return (self.capture.name if self.capture else "") or self.path.resolve().name

    @property
    def command(self) -> str:
        """The command that completes the run. Stages that are complete are not repeated."""
        return f"rtgs run {shlex.quote(str(self.capture or 'CAPTURE'))} --out {shlex.quote(str(self.path))}"

    @property
    def unit(self) -> Unit:
        """Of thermal values."""
        return "°C" if self.summary is None else self.summary.unit

    @property
    def thermal_range(self) -> tuple[float, float] | None:
        """The range of thermal scores and pictures, °C or counts."""
        return None if self.evaluation is None else self.evaluation.thermal_range

    @property
    def baseline_m(self) -> float | None:
        """Distance of the two cameras in metres, as used for the scale; else as the capture states it."""
        found = (self.scale.baseline_m if self.scale else None) or (self.summary.baseline_m if self.summary else None)
        return found or None


def _optional(path: Path, read: Callable[[Path], T]) -> T | None:
    return read(path) if path.is_file() else None


def _being_made_again(run: RunFolder) -> tuple[str, ...]:
    """The first stage that has begun again, and the later ones; none where no stage has."""
    entries = {name: entry for name, entry in run.entries().items() if entry.fingerprint}
    again = [name for name, entry in entries.items() if entry.begun not in ("", entry.fingerprint)]
    return tuple(entries)[list(entries).index(again[0]) :] if again else ()
