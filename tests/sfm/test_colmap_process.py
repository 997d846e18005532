"""COLMAP may end its own process; the one that called it goes on. When that one ends, COLMAP's does too."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.helpers.file_limit import no_file_above
from tests.helpers.photographed_room import NAMES

from rtgs.base.errors import RtgsError
from rtgs.config import SfmConfig
from rtgs.io.capture import load_capture
from rtgs.sfm.colmap_job import Task
from rtgs.sfm.colmap_process import do_apart

pytestmark = [pytest.mark.thorough, pytest.mark.skipif(sys.platform != "linux", reason="limits of files, and /proc")]


def task(room: Path, work: Path) -> Task:
    work.mkdir()
    files = {name: f"{name}.png" for name in NAMES}
    return Task(room, load_capture(room).raw_rig.rgb, SfmConfig(max_features=1000), work, room / "rgb", files, None)


def quiet(done: int, total: int, stage: str) -> None: ...


@pytest.mark.parametrize("limit", [50_000, 400_000])
def test_a_disk_that_fills_while_colmap_works(room: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], limit: int) -> None:
    """At the smaller limit COLMAP raises, at the larger one it aborts its process."""
    with pytest.raises(RtgsError) as refused, no_file_above(limit):
        do_apart(task(room, tmp_path / "work"), quiet)
    text = str(refused.value)
    assert str(tmp_path / "work") in text and "MB are free there" in text and f"may have {limit / 1e6:,.1f} MB" in text
    assert ("SQLite error: disk I/O error" in text) == (limit > 100_000) and "\n" not in text
    assert capfd.readouterr() == ("", "")


def processes_of(work: Path) -> list[int]:
    """Processes that have a file in a folder open."""
    found = []
    for process in Path("/proc").iterdir():
        try:
            files = list((process / "fd").iterdir())
        except OSError:  # no process, another user's, or it has just ended
            continue
        if any(str(work) in target(file) for file in files):
            found.append(int(process.name))
    return found


def target(file: Path) -> str:
    """Where a link points to; empty where it is gone by now."""
    try:
        return str(file.readlink())
    except OSError:
        return ""


PROGRAM = """
import sys
from pathlib import Path
from tests.sfm.test_colmap_process import quiet, task
from rtgs.sfm.colmap_process import do_apart
do_apart(task(Path(sys.argv[1]), Path(sys.argv[2])), quiet)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_no_process_is_left_behind(room: Path, tmp_path: Path, number: signal.Signals) -> None:
    work = tmp_path / "work"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[2]), *sys.path])}
    command = [sys.executable, "-c", PROGRAM, str(room), str(work)]
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + 60
        while not (others := processes_of(work)) and time.monotonic() < deadline:
            time.sleep(0.01)
        (other,) = others
        assert other != process.pid
        process.send_signal(number)
        process.wait(30)
    deadline = time.monotonic() + 10
    while processes_of(work) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not processes_of(work)
