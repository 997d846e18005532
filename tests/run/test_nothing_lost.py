"""A finished run keeps its results when input or settings are refused, and while new results are made."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from tests.helpers.tiny_run import HELD_OUT, all_complete, recorded, state

from rtgs.base.errors import RtgsError
from rtgs.config import RunConfig, ScaleConfig
from rtgs.run.folder import RunFolder
from rtgs.run.job import Job
from rtgs.run.pipeline import Pipeline
from rtgs.run.stages import STAGES


def wrong_width(capture: Path) -> None:
    rig = json.loads((capture / "rig.json").read_text())
    rig["rgb"]["width"] += 7
    (capture / "rig.json").write_text(json.dumps(rig))


BREAK: dict[str, Callable[[Path], object]] = {
    "unreadable picture": lambda capture: (capture / "rgb" / "extra.png").write_bytes(b"no picture"),
    "cut picture": lambda capture: (capture / "rgb" / "frame_003.png").write_bytes(
        (capture / "rgb" / "frame_003.png").read_bytes()[:60]
    ),
    "rgb renamed": lambda capture: (capture / "rgb").rename(capture / "rgb_"),
    "thermal renamed": lambda capture: (capture / "thermal").rename(capture / "thermal_"),
    "wrong width": wrong_width,
    "no rig.json": lambda capture: (capture / "rig.json").unlink(),
    "half of rig.json": lambda capture: (capture / "rig.json").write_text((capture / "rig.json").read_text()[:99]),
    "half of transforms.json": lambda capture: (capture / "transforms.json").write_text("{"),
    "empty thermal image": lambda capture: (capture / "thermal" / "frame_002.tiff").write_bytes(b""),
}


@pytest.mark.parametrize("broken", BREAK)
def test_input_that_is_broken_for_a_moment_costs_nothing(capture: Path, run: Path, tmp_path: Path, broken: str) -> None:
    mine, folder = Path(shutil.copytree(capture, tmp_path / "capture")), RunFolder(run)
    folder.write_config(replace(folder.read_config(), capture=mine))
    before = state(run, but=("hashes.json",))
    BREAK[broken](mine)
    for arguments in (["run", str(mine), "--out", str(run)], ["scale", str(run), "--seed", "7"]):
        assert recorded(arguments)[1] == 2, arguments
        assert state(run, but=("hashes.json",)) == before, arguments
    shutil.rmtree(mine)
    shutil.copytree(capture, mine)
    assert all_complete(run)


@pytest.mark.parametrize("flags", [("--rgb-max-side", "0"), ("--scale.init", "-3")])
def test_a_setting_that_is_refused_costs_nothing_and_is_not_kept(capture: Path, run: Path, flags: tuple[str, ...]) -> None:
    before = state(run, but=("hashes.json",))
    assert recorded(["run", str(capture), "--out", str(run), *flags])[1] == 2
    assert state(run, but=("hashes.json",)) == before and all_complete(run)


def test_a_new_run_that_is_refused_leaves_no_folder(capture: Path, tmp_path: Path) -> None:
    mine = Path(shutil.copytree(capture, tmp_path / "capture"))
    wrong_width(mine)
    assert recorded(["run", str(mine), "--out", str(tmp_path / "run")])[1] == 2
    assert not (tmp_path / "run").exists()


def test_a_stage_that_refuses_its_input_leaves_results_and_settings(run: Path) -> None:
    def refuse(job: Job) -> None:
        job.results.write_scale(job.folder.read_scale())
        raise RtgsError("no scale can be found")

    before = state(run, but=("hashes.json", "stages.json", "config.json"))
    config = RunFolder(run).read_config()
    stages = [replace(stage, work=refuse) if stage.name == "scale" else stage for stage in STAGES]
    changed = replace(config.config, scale=replace(config.config.scale, seed=5))
    with pytest.raises(RtgsError, match="no scale"), Pipeline.start(config.capture, run, changed, stages=stages) as pipeline:
        pipeline.run()
    assert state(run, but=("hashes.json", "stages.json", "config.json")) == before
    assert RunFolder(run).read_config() == config and all_complete(run)


@pytest.mark.thorough
def test_results_can_be_read_while_new_ones_are_made(capture: Path, run: Path) -> None:
    """A stage that is interrupted leaves them, the report says of which settings they are, and the earlier settings find them complete."""
    before = state(run, but=("hashes.json", "stages.json", "config.json", "report.html"))
    recorder, code = recorded(["run", str(capture), "--out", str(run), "--rgb.seed", "1"], stop_in="rgb", stop_at=9)
    assert code == 130 and recorder.works == ["rgb"]
    now = state(run, but=("hashes.json", "stages.json", "config.json", "report.html"))
    assert {k: v for k, v in now.items() if k != "rgb.checkpoint"} == before
    assert "of earlier settings" in (run / "report.html").read_text(encoding="utf-8")
    assert recorded(["render", str(run), "--out", str(run.parent / "views"), "--frames", HELD_OUT[0]])[1] == 0
    recorder, code = recorded(["run", str(capture), "--out", str(run), "--rgb.seed", "0"])
    assert code == 0 and recorder.works == []
    assert "of earlier settings" not in (run / "report.html").read_text(encoding="utf-8")


def test_a_refused_setting_in_a_file_names_the_file(run: Path) -> None:
    path = run / "config.json"
    text = path.read_text(encoding="utf-8")
    assert RunConfig(scale=ScaleConfig()).scale.init is None
    path.write_text(text.replace('"init": null', '"init": -1.0'), encoding="utf-8")
    with pytest.raises(RtgsError, match=r"config\.json.*init"):
        RunFolder(run).read_config()


def test_a_capture_that_no_folder_can_be_names_the_file(run: Path) -> None:
    data = json.loads((run / "config.json").read_text(encoding="utf-8"))
    (run / "config.json").write_text(json.dumps({**data, "capture": "ä" * 300}), encoding="utf-8")
    with pytest.raises(RtgsError, match=r"config\.json: capture names no folder"):
        RunFolder(run).read_config()
