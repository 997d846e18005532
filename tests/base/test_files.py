"""Files and folders are replaced whole, and a failure leaves what was there."""

from __future__ import annotations

from pathlib import Path

import pytest

from rtgs.base.files import recover, write_text_whole, write_whole


class Failed(Exception):
    """What goes wrong while something is written."""


def names(folder: Path) -> set[str]:
    return {p.name for p in folder.iterdir()}


def folder_of(path: Path, **files: str) -> Path:
    path.mkdir(parents=True)
    for name, text in files.items():
        (path / name).write_text(text, encoding="utf-8")
    return path


def test_a_file_is_written_and_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    for text in ("one °C", "two"):
        write_text_whole(path, text)
        assert path.read_text(encoding="utf-8") == text and names(tmp_path) == {"a.txt"}


def test_the_old_file_is_whole_while_the_new_one_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old", encoding="utf-8")
    with write_whole(path) as temporary:
        temporary.write_text("half of the n", encoding="utf-8")
        assert temporary.parent == path.parent and path.read_text(encoding="utf-8") == "old"
        temporary.write_text("new", encoding="utf-8")
    assert path.read_text(encoding="utf-8") == "new"


def test_a_failure_leaves_the_old_file_and_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old", encoding="utf-8")
    with pytest.raises(Failed), write_whole(path) as temporary:
        temporary.write_text("half", encoding="utf-8")
        raise Failed
    assert path.read_text(encoding="utf-8") == "old" and names(tmp_path) == {"a.txt"}


def test_nothing_written_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old", encoding="utf-8")
    with pytest.raises(FileNotFoundError), write_whole(path):
        pass
    assert path.read_text(encoding="utf-8") == "old"


def test_a_folder_is_replaced_with_all_its_files(tmp_path: Path) -> None:
    path = folder_of(tmp_path / "scene", old="1")
    with write_whole(path) as temporary:
        folder_of(temporary, new="2")
        assert names(path) == {"old"}
    assert names(path) == {"new"} and names(tmp_path) == {"scene"}


def test_a_failure_leaves_the_old_folder(tmp_path: Path) -> None:
    path = folder_of(tmp_path / "scene", old="1")
    with pytest.raises(Failed), write_whole(path) as temporary:
        folder_of(temporary, new="2")
        raise Failed
    assert names(path) == {"old"} and names(tmp_path) == {"scene"}


def test_recover_puts_back_the_folder_that_was_being_replaced(tmp_path: Path) -> None:
    """Killed between the two renames: the old folder is aside, the new one is not yet in its place."""
    path = tmp_path / "scene"
    folder_of(tmp_path / ".scene.old.tmp", old="1")
    recover(path)
    assert names(path) == {"old"} and names(tmp_path) == {"scene"}


def test_recover_leaves_a_folder_that_was_replaced(tmp_path: Path) -> None:
    """Killed after the two renames: the new folder is in its place. The next writing removes what stands aside."""
    path = folder_of(tmp_path / "scene", new="2")
    folder_of(tmp_path / ".scene.old.tmp", old="1")
    recover(path)
    assert names(path) == {"new"}
    with write_whole(path) as temporary:
        folder_of(temporary, newer="3")
    assert names(path) == {"newer"} and names(tmp_path) == {"scene"}


def test_recover_of_what_was_never_there_does_nothing(tmp_path: Path) -> None:
    recover(tmp_path / "scene")
    assert names(tmp_path) == set()
