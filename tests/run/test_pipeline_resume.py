"""A run that is cut off anywhere ends as if it had not been."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from tests.helpers.tiny_run import TINY, all_complete, assert_same_results, recorded

from rtgs.run.folder import RunFolder
from rtgs.run.pipeline import Pipeline
from rtgs.run.stages import TITLES

pytestmark = pytest.mark.thorough


def leave_rubbish(run: Path) -> None:
    """What a killed process leaves: half files under temporary names."""
    with subprocess.Popen([sys.executable, "-c", ""]) as dead:
        pass
    for name in ("scale.json", "metrics.json", "stages.json", "rgb.ply", "rgb.json", "config.json"):
        (run / f".{name}.{dead.pid}.tmp").write_bytes(b"\x00 half")
    for name in (f".scene.{dead.pid}.tmp", ".scene.old.tmp"):
        (run / name).mkdir(exist_ok=True)
        (run / name / "images.bin").write_bytes(b"\x07")


@pytest.mark.parametrize(
    ("stage", "at"),
    [("sfm", 0), ("rgb", 25), ("rgb", 1), ("scale", 60), ("thermal", 5), ("thermal_naive", 5), ("spots", 3), ("evaluate", 1)],
)
def test_a_run_stopped_anywhere_resumes_to_the_same_result(
    capture: Path, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], stage: str, at: int
) -> None:
    out = tmp_path / "run"
    arguments = ["run", str(capture), "--out", str(out), *TINY]
    recorder, code = recorded(arguments, stop_in=stage, stop_at=at)
    assert code == 130 and recorder.works[-1] == stage
    assert "goes on from here" in capsys.readouterr().err
    assert (out / "report.html").is_file() and not (out / "metrics.json").exists()
    leave_rubbish(out)

    recorder, code = recorded(["run", str(capture), "--out", str(out)])
    assert code == 0
    done = list(TITLES)[: list(TITLES).index("thermal" if stage == "thermal_naive" else stage)]
    assert recorder.works == [key for key in TITLES if key not in done]
    if stage == "rgb":  # a checkpoint every second step here
        assert recorder.first_step["rgb"] == (25 if at == 25 else 1)
    assert_same_results(finished, out)


def command(capture: Path, out: Path) -> list[str]:
    return [sys.executable, "-m", "rtgs", "run", str(capture), "--out", str(out), *TINY]


def stopped_while_training(capture: Path, out: Path, number: int) -> tuple[int, str]:
    """Send a signal to `rtgs run` once it has a checkpoint; the exit code, and what stood on stderr."""
    with subprocess.Popen(command(capture, out), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120
        while not (out / "rgb.checkpoint").exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.002)
        process.send_signal(number)
        errors = process.communicate()[1]
    assert not (out / "rgb.ply").exists()
    return process.returncode, errors


def test_a_killed_run_resumes_to_the_same_result(capture: Path, finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert stopped_while_training(capture, out, signal.SIGKILL)[0] == -signal.SIGKILL
    leave_rubbish(out)
    recorder, code = recorded(["run", str(capture), "--out", str(out)])
    assert code == 0 and recorder.first_step["rgb"] > 1
    assert_same_results(finished, out)


def test_sigterm_leaves_a_run_that_resumes_bit_for_bit(capture: Path, finished: Path, tmp_path: Path) -> None:
    """Beside a run of another process: a kernel that is compiled may differ in its last bit from the same kernel loaded from the cache."""
    out, whole = tmp_path / "run", tmp_path / "whole"
    code, errors = stopped_while_training(capture, out, signal.SIGTERM)
    assert code == 143 and "goes on from here" in errors and "Traceback" not in errors
    assert (out / "report.html").is_file() and not [p for p in out.iterdir() if p.name.startswith(".")]
    for folder in (out, whole):
        subprocess.run(command(capture, folder), stdout=subprocess.DEVNULL, check=True)
    for name in ("scale.json", "rgb.ply", "rgb.json", "thermal.ply", "thermal.json", "thermal_naive.ply"):
        assert (out / name).read_bytes() == (whole / name).read_bytes(), name
    assert_same_results(finished, out)


def test_killed_while_the_scene_is_replaced(run: Path) -> None:
    (run / "scene").rename(run / ".scene.old.tmp")
    with Pipeline.open(RunFolder(run)):
        assert all_complete(run) and (run / "scene").is_dir()


def test_half_a_training_is_not_continued_with_other_settings_or_images(capture: Path, tmp_path: Path) -> None:
    mine = Path(shutil.copytree(capture, tmp_path / "capture"))
    arguments = ["run", str(mine), "--out", str(tmp_path / "run"), *TINY]
    recorded(arguments, stop_in="rgb", stop_at=9)
    assert (tmp_path / "run" / "rgb.checkpoint").exists()
    recorder, code = recorded([*arguments, "--rgb.seed", "1"], stop_in="rgb", stop_at=9)
    assert code == 130 and recorder.first_step["rgb"] == 1
    shutil.copy(mine / "rgb" / "frame_004.png", mine / "rgb" / "frame_003.png")
    recorder, code = recorded([*arguments, "--rgb.seed", "1"], stop_in="rgb", stop_at=9)
    assert code == 130 and recorder.first_step["rgb"] == 1
    recorder, code = recorded([*arguments, "--rgb.seed", "1"], stop_in="scale")
    assert code == 130 and recorder.first_step["rgb"] == 9  # the last even step, plus one


def test_a_capture_that_is_away_costs_nothing(capture: Path, tmp_path: Path, run: Path) -> None:
    mine, folder = Path(shutil.copytree(capture, tmp_path / "capture")), RunFolder(run)
    folder.write_config(replace(folder.read_config(), capture=mine))
    mine.rename(tmp_path / "away")
    for command in ("thermal", "eval"):
        assert recorded([command, str(run)])[1] == 2
    (tmp_path / "away").rename(mine)
    assert all_complete(run)
