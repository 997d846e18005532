"""Folders, models and settings that a run refuses."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.helpers.tiny_run import all_complete, recorded, state, strict_json

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import from_json, to_json
from rtgs.cli import main
from rtgs.config import RunConfig
from rtgs.io.ply import write_ply
from rtgs.run.folder import RunFolder
from rtgs.run.pipeline import Pipeline


def test_folders_that_are_refused(capture: Path, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = Path(shutil.copytree(capture, tmp_path / "other"))
    shutil.copy(other / "rgb" / "frame_004.png", other / "rgb" / "frame_003.png")
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "thesis.tex").write_text("years of work")
    (tmp_path / "nerf").mkdir()
    (tmp_path / "nerf" / "config.json").write_text('{"model": "nerf"}')
    (tmp_path / "file").write_text("a file")
    refused = [
        (capture, capture, "inside the capture"),
        (capture, capture / "rgb" / "run", "inside the capture"),
        (capture, tmp_path / "foreign", "no run folder"),
        (capture, tmp_path / "nerf", "not written by rtgs"),
        (capture, tmp_path / "file", "no run folder"),
        (other, finished, "run of"),
        (tmp_path / "missing", tmp_path / "new", "no such folder"),
    ]
    before = state(finished) | state(capture)
    for of, out, said in refused:
        with pytest.raises(SystemExit) as stop:
            main(["run", str(of), "--out", str(out)])
        error = capsys.readouterr().err
        assert stop.value.code == 2 and said in error, out
        assert error.startswith("error: ") and error.count("\n") == 1 and "Traceback" not in error
    assert state(finished) | state(capture) == before and not (tmp_path / "new").exists()
    assert (tmp_path / "foreign" / "thesis.tex").exists()


def test_too_little_memory_is_refused_before_any_work(
    capture: Path, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = state(finished)
    for out in (finished, tmp_path / "new"):
        with pytest.raises(SystemExit) as stop:
            main(["run", str(capture), "--out", str(out), "--memory-gb", "0.5", "--rgb.seed", "1"])
        error = capsys.readouterr().err
        assert stop.value.code == 2 and error == "error: memory_gb is 0.5; a run needs 1.0 or more (--memory-gb).\n"
    assert state(finished) == before and not (tmp_path / "new" / "config.json").exists()


def test_a_model_that_cannot_be_imported_is_refused_at_once(capture: Path, finished: Path, run: Path, tmp_path: Path) -> None:
    (tmp_path / "no.ply").write_text("not a PLY")
    write_ply(tmp_path / "thermal.ply", RunFolder(finished).read_thermal().gaussians)
    before = state(run)
    for bad in (tmp_path / "missing.ply", tmp_path / "no.ply", tmp_path / "thermal.ply", run / "rgb.ply"):
        recorder, code = recorded(["rgb", str(run), "--rgb-ply", str(bad)])
        assert code == 2 and recorder.works == []
        if bad.parent != run:
            recorder, code = recorded(["run", str(capture), "--out", str(tmp_path / "new"), "--rgb-ply", str(bad)])
            assert code == 2 and recorder.works == [] and not (tmp_path / "new").exists()
    assert state(run) == before and all_complete(run)


def test_a_folder_that_is_no_run(tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match="not a run folder"):
        Pipeline(RunFolder(tmp_path))


@pytest.mark.parametrize(
    ("stage", "field", "value"),
    [
        ("scale", "magic", 1),
        ("scale", "steps", "many"),
        ("scale", "level_weights", 3),
        ("rgb", "background", "pink"),
        ("rgb", "coarse_to_fine", [[1, 2, 3]]),
        ("rgb", "exposure", 1),
        ("thermal", None, None),
    ],
)
def test_settings_that_are_refused(
    run: Path, capsys: pytest.CaptureFixture[str], stage: str, field: str | None, value: Any
) -> None:
    data = strict_json(run / "config.json")
    if field is None:
        data["settings"][stage] = value
    else:
        data["settings"][stage][field] = value
    (run / "config.json").write_text(json.dumps(data))
    with pytest.raises(SystemExit) as stop:
        main(["thermal", str(run)])
    error = capsys.readouterr().err
    assert stop.value.code == 2 and "config.json" in error and (field or stage.capitalize()) in error and error.count("\n") == 1


def test_settings_survive_json() -> None:
    config = replace(RunConfig(), rgb_ply=Path("/a/b.ply"))
    config = replace(config, rgb=replace(config.rgb, coarse_to_fine=((0.3, 2),)), scale=replace(config.scale, init=2.0, batch=3))
    assert from_json(RunConfig, json.loads(json.dumps(to_json(config))), "here") == config
    assert from_json(RunConfig, {"scale": {"init": 1}}, "here").scale.init == 1.0
