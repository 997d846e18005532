"""One writer a run folder."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.helpers.tiny_run import TINY, recorded, state

from rtgs.base.errors import RtgsError
from rtgs.run.lock import locked

pytestmark = pytest.mark.thorough

HOLD = "import sys, time; from pathlib import Path; from rtgs.run.lock import locked\n"
HOLD += "with locked(Path(sys.argv[1])):\n    print('held', flush=True)\n    sys.stdin.readline()"


@contextmanager
def holder(run: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the run until a line is written to it."""
    command = [sys.executable, "-c", HOLD, str(run)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "held\n"
        try:
            yield process
        finally:
            process.kill()


def names(run: Path) -> set[str]:
    return {p.name for p in run.iterdir()}


def test_the_second_command_is_refused_and_names_the_first(capture: Path, run: Path) -> None:
    before = state(run)
    with holder(run) as first:
        command = [sys.executable, "-m", "rtgs", "run", str(capture), "--out", str(run)]
        second = subprocess.run(command, capture_output=True, text=True)
        assert second.returncode == 2 and second.stdout == ""
        assert f"process {first.pid} (" in second.stderr and str(run) in second.stderr and second.stderr.count("\n") == 1
        for arguments in (["scale", str(run), "--steps", "6"], ["eval", str(run)]):
            recorder, code = recorded(arguments)
            assert code == 2 and recorder.events == []
        assert first.poll() is None
        assert {k: v for k, v in state(run).items() if k != ".lock"} == before
        out = run.parent / "export"  # reading needs no lock
        assert recorded(["export", str(run), "--out", str(out)])[1] == 0 and (out / "rgb.ply").exists()


def test_a_run_that_works_names_its_command(capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    with subprocess.Popen([sys.executable, "-m", "rtgs", "run", str(capture), "--out", str(out), *TINY]) as first:
        while not (out / "stages.json").exists() and first.poll() is None:
            time.sleep(0.02)
        code = recorded(["run", str(capture), "--out", str(out)])[1]
        first.terminate()
    assert code == 2 and first.returncode == 143
    error = capsys.readouterr().err
    assert f"process {first.pid} " in error and f"(`rtgs run {capture} --out {out} " in error


def test_a_lock_ends_with_its_holder(tmp_path: Path) -> None:
    with holder(tmp_path) as first:
        with pytest.raises(RtgsError, match=f"process {first.pid} "), locked(tmp_path):
            pass
        assert first.stdin is not None
        first.stdin.write("\n")
        first.stdin.flush()
        first.wait()
        assert names(tmp_path) == set()
    with locked(tmp_path):
        assert names(tmp_path) == {".lock"}
        with pytest.raises(RtgsError, match=f"process {os.getpid()} "), locked(tmp_path):
            pass
    assert names(tmp_path) == set()


def test_a_killed_holder_locks_nobody_out(tmp_path: Path) -> None:
    with holder(tmp_path) as first:
        first.send_signal(signal.SIGKILL)
        first.wait()
        assert names(tmp_path) == {".lock"}
        with locked(tmp_path):
            assert (tmp_path / ".lock").read_text().startswith(f"{os.getpid()}\n")
    assert names(tmp_path) == set()


def test_temporary_files_of_the_dead_are_removed_and_of_the_living_kept(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as dead:
        pass
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as alive:
        for pid in (dead.pid, alive.pid, os.getpid()):
            (tmp_path / f".report.html.{pid}.tmp").touch()
        (tmp_path / f".scene.{dead.pid}.tmp").mkdir()
        for folder, inside in ((".scene.old.tmp", "old"), ("scene", "new"), (".renders.old.tmp", "old")):
            (tmp_path / folder).mkdir()
            (tmp_path / folder / inside).touch()
        (tmp_path / ".hidden").touch()
        (tmp_path / "a.tmp").touch()
        with locked(tmp_path):
            assert names(tmp_path) == {".lock", f".report.html.{alive.pid}.tmp", "scene", "renders", ".hidden", "a.tmp"}
        assert (tmp_path / "scene" / "new").exists() and (tmp_path / "renders" / "old").exists()
        alive.communicate(b"\n")
