"""What a run depends on: the content of the files that it reads, and of no others."""

from __future__ import annotations

import json
import os
import shutil
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.helpers.tiny_run import NOT_RESULTS, TINY, all_complete, assert_same_results, recorded, state, strict_json

import rtgs
from rtgs.base.errors import RtgsError
from rtgs.config import RunConfig
from rtgs.run.config_file import read_config
from rtgs.run.content import Hashes, read_content
from rtgs.run.stages import STAGES, fingerprints

SOURCE = Path(rtgs.__file__).parent
NAMES = [stage.name for stage in STAGES]


def prints(capture: Path, config: RunConfig | None = None) -> dict[str, str]:
    config = config or RunConfig()
    content = read_content(capture, config.rgb_ply, Hashes(capture / "no run"))
    return {str(name): value for name, value in fingerprints(content, config).items()}


def changed(before: dict[str, str], after: dict[str, str]) -> list[str]:
    return [name for name in NAMES if before[name] != after[name]]


@pytest.fixture
def mine(capture: Path, tmp_path: Path) -> Path:
    """A copy of the capture, with other times."""
    return Path(shutil.copytree(capture, tmp_path / "capture", copy_function=shutil.copyfile))


def alter_one_pixel(picture: Path) -> None:
    pixels = np.array(Image.open(picture))
    pixels[0, 0] ^= 1
    Image.fromarray(pixels).save(picture)


def test_a_copy_or_a_touch_changes_no_fingerprint(capture: Path, mine: Path) -> None:
    before = prints(capture)
    assert prints(mine) == before
    for path in mine.rglob("*"):
        os.utime(path, ns=(1, 1))
    assert prints(mine) == before


def test_every_file_that_is_read_counts_by_its_content(mine: Path) -> None:
    before = prints(mine)
    for name in ("rgb/frame_002.png", "thermal/frame_002.tiff"):
        alter_one_pixel(mine / name)
        after = prints(mine)
        assert changed(before, after) == NAMES, name
        before = after
    text = (mine / "transforms.json").read_text()
    (mine / "transforms.json").write_text(text + " ")
    assert changed(before, prints(mine)) == NAMES
    (mine / "rgb" / "frame_002.png").rename(mine / "rgb" / "frame_02.png")
    assert changed(before, prints(mine)) == NAMES


def test_files_that_are_not_read_do_not_count(mine: Path, tmp_path: Path) -> None:
    before = prints(mine)
    for name in (".DS_Store", "rgb/.DS_Store", "rgb/Thumbs.db", "notes.txt", "ground_truth.json"):
        (mine / name).write_text("whatever")
    assert prints(mine) == before
    (mine / "thermal").rename(tmp_path / "elsewhere")
    (mine / "thermal").symlink_to(tmp_path / "elsewhere")
    assert prints(mine) == before  # a link to the same files


def test_a_setting_counts_from_its_stage_on(mine: Path) -> None:
    config = RunConfig()
    other = replace(config, thermal=replace(config.thermal, steps=7))
    assert changed(prints(mine, config), prints(mine, other)) == ["thermal", "spots", "evaluate"]


def test_another_emissivity_changes_no_pose_and_no_rgb_model(mine: Path) -> None:
    rig, before = strict_json(mine / "rig.json"), prints(mine)
    rig["thermal"]["celsius_offset"] += 1.0
    (mine / "rig.json").write_text(json.dumps(rig))
    after = prints(mine)
    assert changed(before, after) == ["scale", "thermal", "spots", "evaluate"]
    rig["thermal"]["fl_x"] += 1.0
    (mine / "rig.json").write_text(json.dumps(rig))
    assert changed(after, prints(mine)) == NAMES


@pytest.mark.thorough
def test_an_imported_model_counts_by_its_content(mine: Path, finished: Path, tmp_path: Path) -> None:
    for name in ("a.ply", "b.ply"):
        shutil.copy(finished / "rgb.ply", tmp_path / name)
    without, a, b = (prints(mine, replace(RunConfig(), rgb_ply=ply)) for ply in (None, tmp_path / "a.ply", tmp_path / "b.ply"))
    assert a == b and changed(without, a) == ["rgb", "scale", "thermal", "spots", "evaluate"]
    (tmp_path / "a.ply").unlink()
    with pytest.raises(RtgsError, match=r"a\.ply: the RGB model that this run imports has gone"):
        prints(mine, replace(RunConfig(), rgb_ply=tmp_path / "a.ply"))


# The same capture at another place


@pytest.mark.thorough
def test_a_copied_capture_redoes_nothing(run: Path, mine: Path) -> None:
    before = state(run, but=NOT_RESULTS)
    recorder, code = recorded(["run", str(mine), "--out", str(run)])
    assert code == 0 and recorder.works == []
    assert state(run, but=NOT_RESULTS) == before
    assert read_config(run).capture == mine.resolve()  # from now on the copy is the run's capture
    for path in mine.rglob("*"):
        os.utime(path)
    assert recorded(["eval", str(run)])[0].works == ["evaluate"]  # asked for


def test_another_capture_is_refused(run: Path, mine: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = state(run)
    alter_one_pixel(mine / "rgb" / "frame_002.png")
    recorder, code = recorded(["run", str(mine), "--out", str(run)])
    assert code == 2 and recorder.works == [] and "is a run of" in capsys.readouterr().err
    assert state(run) == before


def test_a_run_of_an_older_version_is_known_by_its_capture(capture: Path, run: Path, mine: Path) -> None:
    data = strict_json(run / "config.json")
    older = {"version": "0.0.1", "capture": str(capture.resolve()), "settings": data["settings"]}
    (run / "config.json").write_text(json.dumps(older))
    assert read_config(run).capture == capture.resolve() and all_complete(run)
    assert recorded(["run", str(mine), "--out", str(run)])[0].works == []


def test_run_and_capture_can_be_moved_together(mine: Path, finished: Path, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    there = Path(shutil.copytree(finished, tmp_path / "a" / "run"))
    shutil.move(mine, tmp_path / "a" / "capture")
    assert recorded(["run", str(tmp_path / "a" / "capture"), "--out", str(there)])[0].works == []
    assert strict_json(there / "config.json")["capture"] == "../capture"
    (tmp_path / "a").rename(tmp_path / "b")
    assert read_config(tmp_path / "b" / "run").capture == (tmp_path / "b" / "capture").resolve()
    assert all_complete(tmp_path / "b" / "run")
    (tmp_path / "b" / "run").rename(
        tmp_path / "run"
    )  # and the run alone: the capture is where it was when the run was last started
    (tmp_path / "b").rename(tmp_path / "a")
    assert read_config(tmp_path / "run").capture == (tmp_path / "a" / "capture").resolve()


# Hashes that are remembered


def test_a_file_that_did_not_change_is_not_read_again(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    path.write_bytes(b"content")
    long_ago = time.time_ns() - int(100e9)
    os.utime(path, ns=(long_ago, long_ago))
    time.sleep(0.05)
    hashes = Hashes(tmp_path, settled_s=0.01)
    true = hashes.of(path, "picture.png")
    hashes.write()
    stored = strict_json(tmp_path / "hashes.json")
    stored["picture.png"]["sha256"] = "remembered"
    (tmp_path / "hashes.json").write_text(json.dumps(stored))
    assert Hashes(tmp_path).of(path, "picture.png") == "remembered"
    assert Hashes(tmp_path).of(path, "other.png") == true
    path.write_bytes(b"CONTENT")  # of the same size …
    os.utime(path, ns=(long_ago, long_ago))  # … and of the same time
    assert Hashes(tmp_path).of(path, "picture.png") not in (true, "remembered")


def test_a_file_that_was_just_written_is_not_remembered(tmp_path: Path) -> None:
    path = tmp_path / "picture.png"
    path.write_bytes(b"content")
    hashes = Hashes(tmp_path)
    hashes.of(path, "picture.png")
    hashes.write()
    assert not (tmp_path / "hashes.json").exists()


@pytest.mark.parametrize("text", ["no JSON", "[]", '{"a": {"size": 1}}'])
def test_a_damaged_memory_of_hashes_is_no_loss(tmp_path: Path, text: str) -> None:
    (tmp_path / "hashes.json").write_text(text)
    (tmp_path / "a").write_bytes(b"")
    assert Hashes(tmp_path).of(tmp_path / "a", "a").startswith("e3b0c44298fc")  # SHA-256 of nothing


# The truth is not looked at


@pytest.mark.thorough
def test_the_truth_is_never_read(finished: Path, mine: Path, tmp_path: Path) -> None:
    (mine / "ground_truth.json").write_text("{ no JSON")
    assert recorded(["run", str(mine), "--out", str(tmp_path / "run"), *TINY])[1] == 0
    assert_same_results(finished, tmp_path / "run")


def test_no_source_file_names_the_truth() -> None:
    named = [p for p in SOURCE.rglob("*.py") if "ground_truth" in p.read_text(encoding="utf-8")]
    others = {p.relative_to(SOURCE).as_posix() for p in named if p.relative_to(SOURCE).parts[0] != "synthetic"}
    assert others == {"cli/commands/demo.py"}
