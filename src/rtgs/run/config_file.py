"""`config.json` of a run folder. Light to import: the command line reads it before it loads torch."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

from rtgs import __version__
from rtgs.base.errors import RtgsError
from rtgs.base.json_records import from_json, read_json, write_json
from rtgs.config import RunConfig

NAME = "config.json"


@dataclass(frozen=True)
class SavedRun:
    """What a run was started with.

    Attributes:
        capture: the capture's folder, absolute.
        config: every setting.
        content: hash of the capture's pictures, poses and cameras when the run was last started; "" where an older version wrote the file.
        version: of the package that wrote the file; the current one when it is written.
    """

    capture: Path
    config: RunConfig
    content: str = ""
    version: str = __version__


@dataclass(frozen=True)
class ConfigFile:
    """`config.json` as it is stored. A relative `capture` is relative to the run folder, so that both can be moved together."""

    version: str
    capture: str
    settings: RunConfig
    capture_absolute: str = ""
    capture_content: str = ""


def is_run(path: Path) -> bool:
    """Whether the folder holds a run."""
    return (path / NAME).exists()


def check_run(path: Path) -> None:
    """Raises `RtgsError` where the folder holds no run."""
    if not is_run(path):
        raise RtgsError(f"{path}: not a run folder (no config.json). Start one with `rtgs run CAPTURE --out {path}`.")


def refuse_run(capture: Path) -> None:
    """Raises `RtgsError` where a folder that should be a capture is a run."""
    if is_run(capture):
        raise RtgsError(f"{capture}: is a run folder, not a capture. Name its capture; `rtgs info {capture}` says where that is.")


def write_config(run: Path, saved: SavedRun) -> None:
    """Write `config.json`; the folder exists."""
    config = saved.config
    if config.rgb_ply is not None:
        config = replace(config, rgb_ply=config.rgb_ply.resolve())  # the run may be resumed from elsewhere
    capture = saved.capture.resolve()
    try:
        relative = Path(os.path.relpath(capture, run.resolve())).as_posix()
    except ValueError:  # another drive
        relative = str(capture)
    write_json(run / NAME, ConfigFile(__version__, relative, config, str(capture), saved.content))


def read_config(run: Path) -> SavedRun:
    """What a run was started with. The capture is looked for relative to the run, then where it was when the file was written.

    Raises:
        RtgsError: no run here, or an unreadable file.
    """
    check_run(run)
    path = run / NAME
    data = read_json(path, remedy="Put back a copy of it, or choose another folder for the run.")
    if not isinstance(data, dict) or not isinstance(data.get("capture"), str) or "settings" not in data:
        raise RtgsError(f"{path}: not written by rtgs (no capture or settings in it); choose another folder for the run.")
    file = from_json(ConfigFile, data, str(path))
    relative = Path(os.path.normpath(run.resolve() / file.capture))  # an absolute path stays as it is
    absolute = Path(file.capture_absolute or relative)
    try:
        capture = absolute if absolute.is_dir() and not relative.is_dir() else relative
    except OSError as error:
        raise RtgsError(f"{path}: capture names no folder that there can be ({error.strerror}).") from error
    return SavedRun(capture, file.settings, file.capture_content, file.version)
