"""The folder of the synthetic experiment: one small file for each trial, row and method, written whole or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import read_json, read_record, write_json


@dataclass(frozen=True)
class Record:
    """Result of one method on one row of one trial.

    Attributes:
        truth, start, found: SfM units per metre; `start` is where descents begin.
        error_pct: 100 · |ŝ/s − 1|. product_error_pct: 100 · |ŝ·|t̂| / (s·|t|) − 1|, which an error in the length of the rig's baseline
            does not change.
        iterations: of a descent, the steps until s stays within 0.5 % of the last one; of the search, the scales tried while refining.
        renders: pictures drawn.
        seconds: of one core. Of a descent: its renders, times the seconds that one render with its loss takes.
        half_width_pct: half of the 95 % interval's width; None where there is no interval.
        status: of the estimate; "ok" for methods that give none.
    """

    scene: str
    seed: int
    variant: str
    method: str
    truth: float
    start: float
    found: float
    error_pct: float
    product_error_pct: float
    iterations: int
    renders: int
    seconds: float
    half_width_pct: float | None = None
    status: str = "ok"


class ExperimentFolder:
    """Scenes, records, tables and figures of one experiment.

    Raises:
        RtgsError: it holds results of other settings, or something else.
    """

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        self.path = Path(path)
        written = self.path / "settings.json"
        if written.exists():
            if read_json(written, remedy="Name another folder.") != settings:
                raise RtgsError(f"{self.path}: holds results of other settings ({written.name}); name another folder.")
        elif self.path.is_dir() and any(self.path.iterdir()):
            raise RtgsError(f"{self.path}: holds something other than an experiment; name a new or empty folder.")
        for folder in (self.path, self.path / "records", self.path / "scenes"):
            folder.mkdir(parents=True, exist_ok=True)
        if not written.exists():
            write_json(written, settings)

    def scene(self, name: str) -> Path:
        return self.path / "scenes" / name

    def record_path(self, scene: str, seed: int, variant: str, method: str) -> Path:
        return self.path / "records" / f"{scene}.{seed}.{variant}.{method}.json"

    def has(self, scene: str, seed: int, variant: str, method: str) -> bool:
        return self.record_path(scene, seed, variant, method).exists()

    def write(self, record: Record) -> None:
        write_json(self.record_path(record.scene, record.seed, record.variant, record.method), record)

    def records(self) -> list[Record]:
        """All there are, by file name.

        Raises:
            RtgsError: a file is no record of this version.
        """
        return [
            read_record(Record, path, remedy="Remove it and call again.")
            for path in sorted((self.path / "records").glob("*.json"))
        ]
