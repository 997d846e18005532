"""A disk that is full costs the work of the moment, and no more."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from PIL import Image
from tests.helpers.file_limit import no_file_above
from tests.helpers.tiny_run import HELD_OUT, TINY, all_complete, recorded, state

from rtgs.base.files import write_whole

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no limit of file sizes there")
OTHERS = ("hashes.json", "stages.json", "config.json", "report.html")


def error_of(capsys: pytest.CaptureFixture[str]) -> str:
    text = capsys.readouterr().err
    assert text.startswith("error: ") and text.count("\n") == 1 and "Traceback" not in text
    return text


def test_a_write_that_fails_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("old")
    with pytest.raises(OSError, match="File too large") as stop, no_file_above(1000), write_whole(tmp_path / "file") as temporary:
        temporary.write_bytes(bytes(2000))
    assert stop.value.filename == str(tmp_path / "file")
    assert [p.name for p in tmp_path.iterdir()] == ["file"] and (tmp_path / "file").read_text() == "old"


def test_training_without_room_for_its_state(capture: Path, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = state(run, but=OTHERS)
    with no_file_above(30_000):
        assert recorded(["run", str(capture), "--out", str(run), "--rgb.seed", "1"])[1] == 2
    assert "rgb.checkpoint: File too large" in error_of(capsys) and state(run, but=OTHERS) == before
    assert recorded(["run", str(capture), "--out", str(run), "--rgb.seed", "0"])[1] == 0 and all_complete(run)


def test_structure_from_motion_without_room(capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """COLMAP would abort the process."""
    with no_file_above(1_000_000):
        assert recorded(["run", str(capture), "--out", str(tmp_path / "run"), *TINY])[1] == 2
    error = error_of(capsys)
    assert "structure from motion may need" in error and "may have 1.0 MB" in error
    assert not [p for p in (tmp_path / "run").iterdir() if p.name.endswith(".tmp")]


@pytest.mark.parametrize("limit", [300, 3_000, 20_000])
def test_exports_and_views_are_whole_or_absent(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], limit: int
) -> None:
    for arguments in (["export"], ["spots"], ["render", "--frames", HELD_OUT[0]]):
        whole, out = tmp_path / f"{arguments[0]} whole", tmp_path / arguments[0]
        command = [arguments[0], str(finished), *arguments[1:], "--out"]
        with no_file_above(limit):
            code = recorded([*command, str(out)])[1]
        assert recorded([*command, str(whole)])[1] == 0
        sizes = {k: len(v) for k, (_, v) in state(whole).items()}
        assert code == (2 if max(sizes.values()) > limit else 0)
        if code:
            assert str(out) in error_of(capsys)
        assert {k: len(v) for k, (_, v) in state(out).items()}.items() <= sizes.items()
        assert recorded([*command, str(out)])[1] == 0
        assert {k: len(v) for k, (_, v) in state(out).items()} == sizes


def test_a_synthetic_capture_is_whole_or_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "capture"
    command = ["synth", "--out", str(out), "--frames", "3", "--size", "48", "--supersampling", "1"]
    with no_file_above(3000):
        assert recorded(command)[1] == 2
    assert str(out) in error_of(capsys) and not (out / "rig.json").exists()
    for path in (*out.rglob("*.png"), *out.rglob("*.tiff")):
        with Image.open(path) as image:
            image.load()
    assert recorded(command)[1] == 0 and (out / "rig.json").exists() and not list(out.rglob("*.tmp"))
