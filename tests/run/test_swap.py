"""New results take the places of old ones together, or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from rtgs.run.lock import locked
from rtgs.run.swap import MAKING, WHOLE, complete_replacement, new_results, replace_results


def contents(run: Path) -> dict[str, str]:
    return {p.relative_to(run).as_posix(): p.read_text() for p in run.rglob("*") if p.is_file()}


@pytest.fixture
def run(tmp_path: Path) -> Path:
    (tmp_path / "scene").mkdir()
    for name in ("rgb.ply", "scale.json", "stages.json", "config.json", "scene/images.bin", "scene/old.bin"):
        (tmp_path / name).write_text("old")
    return tmp_path


def make(new: Path) -> None:
    (new / "scene").mkdir()
    for name in ("rgb.ply", "stages.json", "scene/images.bin"):
        (new / name).write_text("new")


NEW = {"rgb.ply": "new", "stages.json": "new", "config.json": "old", "scene/images.bin": "new"}


def test_all_are_replaced_and_what_is_gone_is_removed(run: Path) -> None:
    with new_results(run) as new:
        make(new)
        replace_results(run, ["rgb.ply", "scale.json", "never.json"])
    assert contents(run) == NEW and not list(run.glob(".*"))


def test_work_that_fails_leaves_the_old_results(run: Path) -> None:
    before = contents(run)
    with pytest.raises(OSError, match="disk"), new_results(run) as new:
        make(new)
        raise OSError("disk full")
    assert contents(run) == before and not list(run.glob(".*"))


def test_new_results_that_a_killed_process_was_making_are_removed(run: Path) -> None:
    before = contents(run)
    (run / MAKING).mkdir()
    make(run / MAKING)
    with locked(run):
        pass
    assert contents(run) == before


@pytest.mark.parametrize(
    "done", [(), ("gone",), ("gone", "rgb.ply"), ("gone", "rgb.ply", "scene"), ("gone", "scene half"), ("all",)]
)
def test_a_replacement_that_was_killed_is_completed(run: Path, done: tuple[str, ...]) -> None:
    """Cut off after any of its steps; whoever locks the run next does the rest."""
    (run / WHOLE).mkdir()
    make(run / WHOLE)
    (run / WHOLE / "gone.json").write_text('["scale.json"]')
    if "gone" in done:
        (run / "scale.json").unlink()
    if "rgb.ply" in done:
        (run / WHOLE / "rgb.ply").replace(run / "rgb.ply")
    if "scene" in done or "scene half" in done:
        for path in (run / "scene").iterdir():
            path.unlink()
        (run / "scene").rmdir()
    if "scene" in done:
        (run / WHOLE / "scene").rename(run / "scene")
    if "all" in done:
        complete_replacement(run)
    with locked(run):
        assert {k: v for k, v in contents(run).items() if k != ".lock"} == NEW
