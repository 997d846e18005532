"""New results of a run are made beside the old ones, and take their places together once they are whole.

A crash leaves the old results or the new ones: once the folder of new results has its second name, the list in it says all that is still
to be done, and doing it twice changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.files import remove
from rtgs.base.json_records import read_json, write_json

MAKING = ".next.tmp"  # new results that are being made
WHOLE = ".whole.tmp"  # new results that are whole; some of them may have been moved already
_GONE = "gone.json"  # names of old results that nothing replaces
_LAST = "stages.json"  # says which results are complete, so it is moved when they are there


@contextmanager
def new_results(run: Path) -> Iterator[Path]:
    """An empty folder for new results. What has not been given to `replace_results` is removed when the block ends."""
    folder = run / MAKING
    remove(folder)
    folder.mkdir()
    try:
        yield folder
    finally:
        remove(folder)


def replace_results(run: Path, gone: Sequence[str]) -> None:
    """Put what lies in the folder of `new_results` in the place of old files and folders of the same names.

    Args:
        gone: names of old results that are removed. They are removed first.
    """
    new = run / MAKING
    write_json(new / _GONE, [name for name in gone if not (new / name).exists()])
    new.rename(run / WHOLE)
    complete_replacement(run)


def complete_replacement(run: Path) -> None:
    """Do what is left of a `replace_results` that was killed. Does nothing where there was none."""
    new = run / WHOLE
    if not (new / _GONE).exists():
        remove(new)
        return
    for name in _names_in(new / _GONE):
        remove(run / name)
    for path in sorted(new.iterdir(), key=lambda path: path.name == _LAST):
        if path.name == _GONE:
            continue
        if path.is_dir():
            remove(run / path.name)
        path.replace(run / path.name)
    remove(new)


def _names_in(path: Path) -> list[str]:
    """The list of names in a file. What is named is removed, so nothing outside of the run may be."""
    remedy = f"Remove the folder {path.parent} and run again."
    names = read_json(path, remedy=remedy)
    if not isinstance(names, list) or not all(isinstance(name, str) and name == Path(name).name for name in names):
        raise RtgsError(f"{path}: does not list names of files. {remedy}")
    return names
