"""What is read of runs that are whole, half finished, damaged or going on."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.helpers.viewed_wall import NAMES

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import write_json
from rtgs.records.spots import SpotList
from rtgs.run.folder import RunFolder
from rtgs.viewer.contents import PARTS, Contents, read_contents, with_spots
from rtgs.viewer.start import Viewer


def test_a_whole_run_has_everything_and_nothing_to_say(contents: Contents) -> None:
    assert contents.rgb and contents.thermal and contents.scale and contents.scene and not contents.messages
    assert tuple(contents.scene.world_from_rgb) == NAMES and contents.metric


def test_an_empty_folder_says_what_is_missing(tmp_path: Path) -> None:
    found = read_contents(tmp_path / "nothing")
    assert found.rgb is found.thermal is found.scale is found.scene is None
    assert set(found.messages) >= set(PARTS)


@pytest.mark.parametrize("name", ["nothing", "capture"])
def test_a_folder_that_is_no_run_is_not_opened(tmp_path: Path, name: str) -> None:
    (tmp_path / "capture" / "rgb").mkdir(parents=True)
    with pytest.raises(RtgsError, match="not a run folder"):
        Viewer(tmp_path / name, port=0)


@pytest.mark.parametrize(
    "name", ["rgb.ply", "thermal.ply", "rgb.json", "thermal.json", "scale.json", "scene/images.bin", "scene/world.json"]
)
def test_a_file_that_is_cut_off_gives_a_message(run: Path, name: str) -> None:
    path = run / name
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    found = read_contents(run)
    assert any(Path(name).name in text or "scene" in text for text in found.messages.values()), found.messages


@pytest.mark.parametrize("name", ["rgb.ply", "thermal.ply", "scale.json"])
def test_a_file_that_has_gone_gives_a_message_and_the_rest_is_there(run: Path, name: str) -> None:
    (run / name).unlink()
    found = read_contents(run)
    assert found.messages
    assert (found.rgb is None) == (name == "rgb.ply") and (found.thermal is None) == (name == "thermal.ply")


def test_a_capture_that_has_gone_leaves_the_models(run: Path) -> None:
    folder = RunFolder(run)
    saved = folder.read_config()
    away = run.parent / "capture"
    shutil.copytree(saved.capture, away)
    folder.write_config(type(saved)(away, saved.config))
    shutil.rmtree(away)
    found = read_contents(run)
    assert found.rgb is not None and found.scene is None and "capture" in found.messages["scene"]


def test_only_what_has_changed_is_read_again(run: Path) -> None:
    before = read_contents(run)
    (run / "scale.json").write_bytes((run / "scale.json").read_bytes() + b"\n")
    after = read_contents(run, before=before)
    assert after.rgb is before.rgb and after.thermal is before.thermal and after.scale is not before.scale


def test_a_message_goes_once_the_file_is_whole(run: Path) -> None:
    whole = (run / "thermal.json").read_bytes()
    (run / "thermal.json").write_bytes(whole[:20])
    before = read_contents(run)
    assert before.thermal is None and "thermal" in before.messages
    assert read_contents(run, before=before).messages == before.messages
    (run / "thermal.json").write_bytes(whole)
    after = read_contents(run, before=before)
    assert after.thermal is not None and not after.messages


@pytest.mark.parametrize("change", [{"length_unit": "SfM units"}, {"unit": "counts"}])
def test_a_list_of_spots_in_other_units_is_not_shown(run: Path, tmp_path: Path, change: dict[str, str]) -> None:
    """It was made before a length or degrees were known. It is read as soon as it fits."""
    spots, fits = tmp_path / "spots.json", SpotList((), "°C", "made up")
    write_json(spots, replace(fits, **change))  # type: ignore[arg-type]
    before = read_contents(run, spots)
    assert before.spots is None and "Make the list again" in before.messages["spots"]
    write_json(spots, fits)
    after = read_contents(run, spots, before)
    assert after.spots == fits and not after.messages


@pytest.mark.parametrize("name", ["scale.json", "thermal.json"])
def test_a_list_that_was_found_here_goes_with_what_it_was_found_in(run: Path, name: str) -> None:
    fits = SpotList((), "°C", "made up")
    before = with_spots(read_contents(run), fits)
    assert read_contents(run, before=before).spots == fits
    (run / name).write_bytes((run / name).read_bytes() + b"\n")
    assert read_contents(run, before=before).spots is None


def test_what_is_up_is_what_the_cameras_had_above_them(contents: Contents) -> None:
    assert contents.up @ np.array([0.0, -1.0, 0.0]) > 0.95
    lo, hi = contents.box
    assert (hi > lo).all()


def test_the_list_of_the_run_is_shown_unless_another_is_named(run: Path, tmp_path: Path) -> None:
    own, other = SpotList((), "°C", "of the run"), SpotList((), "°C", "named")
    before = read_contents(run)
    assert before.spots is None
    (run / "spots").mkdir()
    write_json(run / "spots" / "spots.json", own)
    write_json(tmp_path / "spots.json", other)
    assert read_contents(run, before=before).spots == own
    assert read_contents(run, tmp_path / "spots.json").spots == other
