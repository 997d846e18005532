"""`config.json` of a run folder. Light to import: the command line reads it before it loads torch."""

from __future__ import annotations

from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import from_json, read_run_json
from rtgs.config import RunConfig


def is_run(path: Path) -> bool:
    """Whether the folder holds a run."""
    return (path / "config.json").exists()


def read_config(run: Path) -> tuple[Path, RunConfig]:
    """The capture's folder and the settings of a run.

    Raises:
        RtgsError: no run here, or an unreadable file.
    """
    if not is_run(run):
        raise RtgsError(f"{run}: not a run folder (no config.json). Start one with `rtgs run CAPTURE --out {run}`.")
    path = run / "config.json"
    data = read_run_json(path)
    if not isinstance(data, dict) or not isinstance(data.get("capture"), str) or "settings" not in data:
        raise RtgsError(f"{path}: not written by rtgs (no capture or settings in it); choose another folder for the run.")
    return Path(data["capture"]), from_json(RunConfig, data["settings"], str(path))
