"""A few kills and full disks; `make faults` does many."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.faults.full_disks import attempt, said, without_temporary_space
from tests.faults.kills import kill_and_resume
from tests.faults.processes import can_mount, processes_at, read_only, results, rtgs
from tests.helpers.tiny_run import SYNTH, TINY

from rtgs.synthetic import write_capture

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(sys.platform != "linux", reason="signals, /proc and mounts as Linux has them"),
]
needs_root = pytest.mark.skipif(not can_mount(), reason="this user may not mount file systems")


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures") / "lego"
    write_capture(folder, SYNTH)
    return folder


@pytest.fixture(scope="module")
def whole(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that nothing has disturbed."""
    out = tmp_path_factory.mktemp("runs") / "whole"
    with rtgs(command(capture, out)) as process:
        errors = process.communicate()[1]
    assert process.returncode == 0, errors
    return out


def command(capture: Path, run: Path) -> list[str]:
    return ["run", str(capture), "--out", str(run), *TINY]


def test_three_kills_of_one_run(capture: Path, whole: Path, tmp_path: Path) -> None:
    moments = [(signal.SIGKILL, 2.5), (signal.SIGTERM, 4.0), (signal.SIGINT, 5.5)]
    kills = kill_and_resume(command(capture, tmp_path / "run"), tmp_path / "run", results(whole), moments)
    assert not [k for k in kills if k.wrong]


@needs_root
@pytest.mark.parametrize("size", [8_000, 60_000])
def test_an_export_to_a_full_disk(whole: Path, tmp_path: Path, size: int) -> None:
    reference, disk = tmp_path / "reference", tmp_path / "disk"
    arguments = ["export", str(whole), "--out"]
    assert said([*arguments, str(reference)])[0] == 0
    tried = attempt("export", [*arguments, str(disk / "out")], disk, disk / "out", size, results(reference))
    assert not tried.wrong and tried.code == 2


@needs_root
def test_a_run_on_a_full_disk(capture: Path, whole: Path, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    tried = attempt("run", command(capture, disk / "run"), disk, disk / "run", 200_000, results(whole))
    assert not tried.wrong and tried.code == 2


@needs_root
def test_an_export_without_temporary_space(whole: Path, tmp_path: Path) -> None:
    reference, out = tmp_path / "reference", tmp_path / "out"
    assert said(["export", str(whole), "--out", str(reference)])[0] == 0
    tried = without_temporary_space(["export", str(whole), "--out", str(out)], tmp_path / "disk", out, 8192, results(reference))
    assert not tried.wrong and tried.code == 0


@needs_root
def test_folders_that_cannot_be_written(capture: Path, whole: Path, tmp_path: Path) -> None:
    """A capture may be read-only. A run may not, and its results can still be exported."""
    before = results(whole)
    with read_only(whole):
        code, errors = said([*command(capture, whole), "--rgb.seed", "7"])
        assert code == 2 and str(whole) in errors and "Read-only" in errors and errors.count("\n") == 1
        assert said(["export", str(whole), "--out", str(tmp_path / "export")])[0] == 0
    assert results(whole) == before
    (tmp_path / "locked").mkdir()
    with read_only(tmp_path / "locked"):
        code, errors = said(["export", str(whole), "--out", str(tmp_path / "locked" / "export")])
        assert code == 2 and str(tmp_path / "locked") in errors and errors.count("\n") == 1
    with read_only(capture):
        assert said(command(capture, whole))[0] == 0
    assert results(whole) == before


def test_two_processes_on_one_run(capture: Path, whole: Path, tmp_path: Path) -> None:
    """The second is refused and names the first; the first ends as if it had been alone."""
    run = tmp_path / "run"
    with rtgs(command(capture, run)) as first:
        deadline = time.monotonic() + 60
        while not (run / ".lock").exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        second = subprocess.run(
            [sys.executable, "-m", "rtgs", *command(capture, run)], capture_output=True, text=True, check=False
        )
        assert second.returncode == 2 and f"process {first.pid}" in second.stderr and second.stderr.count("\n") == 1
        errors = first.communicate()[1]
    assert first.returncode == 0, errors
    assert results(run) == results(whole) and not processes_at(run) and os.getpid()
