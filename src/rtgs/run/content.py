"""What a run is made from, by what it holds: a copy or a `touch` of the capture changes nothing, one changed pixel does."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rtgs.base.errors import RtgsError
from rtgs.base.files import sha256_of
from rtgs.base.json_records import from_json, read_json, write_json
from rtgs.io.image_files import IMAGE_SUFFIXES
from rtgs.io.metres_file import NAME as METRES
from rtgs.io.rig import MISSING, read_json_object, without_radiometry

NAME = "hashes.json"
SETTLED_S = 2.0  # a file that was changed less than this before it was read may change again within the clock's resolution


@dataclass(frozen=True)
class Content:
    """What the stages depend on beside their settings.

    Attributes:
        files: path in the capture → SHA-256, of the pictures and poses that `load_capture` reads, and of no other file.
        cameras, radiometry: the two parts of `rig.json`. Another emissivity changes no pose and no RGB model.
        rgb_ply: SHA-256 of the RGB model to import, if there is one. metres: of `metres.json`, likewise.
    """

    files: Mapping[str, str]
    cameras: Mapping[str, Any]
    radiometry: Mapping[str, Any]
    rgb_ply: str | None
    metres: str | None = None

    @property
    def capture_hash(self) -> str:
        """Of the pictures, the poses and the cameras: by it a capture is known again at another place."""
        return hashlib.sha256(json.dumps([dict(self.files), self.cameras]).encode()).hexdigest()


@dataclass(frozen=True)
class _Known:
    """A file's hash, and what its status was when it was read."""

    size: int
    mtime_ns: int
    ctime_ns: int
    sha256: str


class Hashes:
    """Hashes of files, remembered in the run folder so that an unchanged capture is not read again.

    A remembered hash counts while the file's size and times are the same. The time of the last status change is among them, since
    archives and copies can give two different files the same name, size and time of modification.
    """

    def __init__(self, run: Path, settled_s: float = SETTLED_S) -> None:
        self._settled_ns = settled_s * 1e9
        self._path = run / NAME
        self._known: dict[str, _Known] = {}
        if self._path.exists():
            try:
                data = read_json(self._path)
                self._known = {k: from_json(_Known, v, str(self._path)) for k, v in data.items()}
            except (RtgsError, AttributeError):
                pass  # nothing is lost but time
        self._used: dict[str, _Known] = {}

    def of(self, path: Path, name: str) -> str:
        """SHA-256 of a file that is remembered as `name`."""
        status, now_ns = path.stat(), time.time_ns()
        known = self._used.get(name) or self._known.get(name)
        if known is None or (known.size, known.mtime_ns, known.ctime_ns) != _status(status):
            known = _Known(*_status(status), sha256_of(path))
        if now_ns - max(status.st_mtime_ns, status.st_ctime_ns) > self._settled_ns:
            self._used[name] = known
        return known.sha256

    def write(self) -> None:
        """Remember the hashes that were asked for, and only those. The run's lock is held."""
        if self._used != self._known:
            write_json(self._path, self._used)
            self._known = dict(self._used)


def _status(status: os.stat_result) -> tuple[int, int, int]:
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns


def read_content(capture: Path, rgb_ply: Path | None, hashes: Hashes) -> Content:
    """The content of a capture and of the RGB model to import.

    Raises:
        RtgsError: `rig.json` or the model is missing or unreadable.
    """
    folders = [capture / "sparse" / "0"] + [capture / name for name in ("rgb", "thermal")]
    files = [p for folder in folders if folder.is_dir() for p in folder.iterdir() if not p.name.startswith(".")]
    files = [p for p in files if p.parent == folders[0] or p.suffix.lower() in IMAGE_SUFFIXES]
    files = sorted(p for p in (*files, capture / "transforms.json") if p.is_file())
    cameras, radiometry = without_radiometry(read_json_object(capture / "rig.json", missing=MISSING))
    if rgb_ply is not None and not rgb_ply.is_file():
        raise RtgsError(f"{rgb_ply}: the RGB model that this run imports has gone. Put it back, or name another with --rgb-ply.")
    metres = capture / METRES
    return Content(
        {name: hashes.of(p, name) for p in files for name in [p.relative_to(capture).as_posix()]},
        cameras,
        radiometry,
        None if rgb_ply is None else hashes.of(rgb_ply, str(rgb_ply)),
        hashes.of(metres, METRES) if metres.is_file() else None,
    )
