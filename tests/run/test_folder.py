"""Files of a run that are missing or damaged, and which stages count as complete."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from tests.helpers.tiny_run import all_complete, complete_stages, recorded, state

from rtgs.base.errors import RtgsError
from rtgs.run.folder import RunFolder, StageEntry
from rtgs.run.stages import STAGES
from rtgs.run.swap import new_results

READERS: dict[str, Callable[[RunFolder], object]] = {
    "stages.json": RunFolder.entries,
    "config.json": RunFolder.read_config,
    "scale.json": RunFolder.read_scale,
    "rgb.json": RunFolder.read_rgb,
    "rgb.ply": RunFolder.read_rgb,
    "thermal.json": RunFolder.read_thermal,
    "thermal.ply": RunFolder.read_thermal,
    "scene": RunFolder.load_scene,
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("damage", ["half of it", "[]"])
def test_a_damaged_file_is_named(run: Path, name: str, damage: str) -> None:
    path = run / name if name != "scene" else run / "scene" / "images.bin"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2] if damage == "half of it" else b"[]")
    with pytest.raises(RtgsError, match=name):
        READERS[name](RunFolder(run))


@pytest.mark.parametrize("name", [name for name in READERS if name not in ("stages.json", "scene")])
def test_a_missing_file_is_named(run: Path, name: str) -> None:
    (run / name).unlink()
    with pytest.raises(RtgsError, match=f"{name}.*rtgs run" if name != "config.json" else name):
        READERS[name](RunFolder(run))


@pytest.mark.parametrize("name", ["rgb.ply", "thermal.ply"])
def test_a_cut_off_model_says_how_to_get_it_back(run: Path, name: str) -> None:
    (run / name).write_bytes((run / name).read_bytes()[:1000])
    with pytest.raises(RtgsError, match=rf"{name}: .*[^.]\. Remove it and run again\.$"):
        READERS[name](RunFolder(run))


def test_output_into_or_below_a_file_is_refused(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "file"
    file.touch()
    outputs = {"render": file, "spots": file / "in it", "export": file, "share": file / "page.html"}
    for command, out in outputs.items():
        assert recorded([command, str(run), "--out", str(out)])[1] == 2, command
        assert f"{file}: is a file, and a folder is needed" in " ".join(capsys.readouterr().err.split())


def test_a_capture_gets_no_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "rgb").mkdir()
    assert recorded(["report", str(tmp_path)])[1] == 2
    assert "not a run folder" in capsys.readouterr().err and not (tmp_path / "report.html").exists()


@pytest.mark.parametrize("command", ["doctor", "run"])
def test_a_run_is_no_capture(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    more = ["--out", str(tmp_path / "new")] if command == "run" else []
    assert recorded([command, str(run), *more])[1] == 2
    assert "is a run folder, not a capture" in capsys.readouterr().err


def test_a_run_without_stages_has_none(run: Path) -> None:
    (run / "stages.json").unlink()
    assert RunFolder(run).entries() == {} and complete_stages(run) == []


def test_a_stage_that_begins_leaves_results_and_removes_half_done_work(run: Path) -> None:
    folder = RunFolder(run)
    assert all_complete(run)
    (run / "rgb.checkpoint").touch()
    before = state(run, but=("stages.json",))
    folder.begin(STAGES[2:], "other")
    assert folder.entries()["scale"].begun == "other" and state(run, but=("stages.json",)) == before
    folder.begin(STAGES[1:], "first")
    assert not (run / "rgb.checkpoint").exists()
    (run / "rgb.checkpoint").touch()
    folder.begin(STAGES[1:], "first")  # it goes on
    assert (run / "rgb.checkpoint").exists() and all_complete(run)
    folder.withdraw(STAGES[1])
    assert folder.entries()["rgb"].begun == "" and all_complete(run)


def test_a_stage_that_ends_takes_the_later_ones_with_it(run: Path) -> None:
    folder, names = RunFolder(run), ("rgb.ply", "rgb.json", "scene")
    (run / "rgb.checkpoint").touch()
    folder.begin(STAGES[1:], "first")
    with new_results(run) as new:
        for name in ("rgb.ply", "rgb.json"):
            (new / name).write_text(f"new {name}")
        folder.finish(STAGES[1:], "first", {"rgb": 2.0})
    assert complete_stages(run) == ["sfm"] and folder.seconds()["rgb"] == 2.0
    assert folder.entries()["rgb"] == StageEntry("first", seconds={"rgb": 2.0}) and "scale" not in folder.entries()
    assert (run / "rgb.ply").read_text() == "new rgb.ply" and all((run / name).exists() for name in names)
    for name in ("rgb.checkpoint", "scale.json", "thermal.ply", "metrics.json", "renders"):
        assert not (run / name).exists(), name


def test_a_read_only_command_says_which_stage_is_missing(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run / "thermal.json").unlink()
    assert recorded(["export", str(run), "--out", str(run.parent / "out")])[1] == 2
    assert "thermal.json: no such file. `rtgs run`" in capsys.readouterr().err
