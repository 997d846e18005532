"""Where a table comes from: the command, the version, the machine and the date, as the head of a Markdown page.

The commands that make tables use it, so that a page of results can be made again. No path and no host name is in it.
"""

from __future__ import annotations

import dataclasses
import os
import platform
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from rtgs import __version__
from rtgs.base.files import write_text_whole

HEADING = "measured with"
"""What the table of a provenance begins with."""


@dataclass(frozen=True)
class Provenance:
    """What made a table.

    Attributes:
        command: as a person would type it; folders and files by name alone.
        version: of this package. python: of the interpreter.
        cpu, cores: the processor's model, and how many cores the process may use.
        day: ISO date.
    """

    command: str
    version: str
    python: str
    cpu: str
    cores: int
    day: str

    @staticmethod
    def of(command: str) -> Provenance:
        """Of this process, today."""
        return Provenance(command, __version__, platform.python_version(), _cpu_model(), _core_count(), date.today().isoformat())

    def markdown(self) -> str:
        """Two columns in Markdown, below the heading `HEADING`."""
        machine = f"{self.cpu}, {self.cores} {'core' if self.cores == 1 else 'cores'}, Python {self.python}"
        rows = {"command": f"`{self.command}`", "version": self.version, "machine": machine, "date": self.day}
        return "\n".join([f"| {HEADING} | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows.items())])


@dataclass(frozen=True)
class Page:
    """A page of results in Markdown. body: everything below title and provenance."""

    title: str
    body: str

    def write(self, path: Path, provenance: Provenance) -> Path:
        """Write it, whole or not at all, and return its path."""
        write_text_whole(path, f"# {self.title}\n\n{provenance.markdown()}\n\n{self.body}")
        return path


def command_line(start: str, settings: Any, defaults: Any) -> str:
    """`start` and the flags of every setting that differs from its default.

    Args:
        start: the command with its arguments, e.g. "rtgs experiment synthetic --out DIR".
        settings, defaults: two instances of one dataclass, whose fields are flags of the command.
    """
    return " ".join([start, *_flags(settings, defaults)])


def _flags(settings: Any, defaults: Any, prefix: str = "") -> Iterator[str]:
    for field in dataclasses.fields(settings):
        name, value, usual = field.name.replace("_", "-"), getattr(settings, field.name), getattr(defaults, field.name)
        if dataclasses.is_dataclass(value) and dataclasses.is_dataclass(usual):
            yield from _flags(value, usual, f"{prefix}{name}.")
        elif value != usual and isinstance(value, bool):
            yield f"--{prefix}{name}" if value else f"--{prefix}no-{name}"
        elif value != usual:
            values = value if isinstance(value, tuple | list) else (value,)
            yield " ".join([f"--{prefix}{name}", *(shlex.quote(v.name if isinstance(v, Path) else str(v)) for v in values)])


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        lines = []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor() or platform.machine() or "an unknown processor"


def _core_count() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
