"""Commands on disks of several sizes, of which most are too small; then on a larger one."""

from __future__ import annotations

import contextlib
import io
import os
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.faults.processes import resize, results, small_disk
from tests.helpers.tiny_run import recorded

PLENTY = 512 << 20


@dataclass(frozen=True)
class Attempt:
    """A command on a disk of so many bytes: its exit code, and what was wrong ("" where nothing was)."""

    what: str
    size: int
    code: int
    wrong: str


def attempt(what: str, arguments: list[str], disk: Path, out: Path, size: int, whole: dict[str, str]) -> Attempt:
    """Run a command whose files go to `out` on the disk at `disk`; then make the disk larger, and run it again."""
    with small_disk(disk, size):
        code, errors = said(arguments)
        wrong = _wrong(code, errors)
        resize(disk, PLENTY)
        again, errors = said(arguments)
        if again != 0:
            wrong.append(f"a second call on a large disk: exit code {again}: {errors[-300:]}")
        else:
            wrong += _differing(out, whole)
    return Attempt(what, size, code, "; ".join(wrong))


def without_temporary_space(arguments: list[str], disk: Path, out: Path, size: int, whole: dict[str, str]) -> Attempt:
    """Run a command whose TMPDIR is a disk of so many bytes, all of them taken."""
    with small_disk(disk, size):
        with contextlib.suppress(OSError), (disk / "full").open("wb", buffering=0) as file:
            while file.write(bytes(4096)):
                pass
        with _temporary(disk):
            code, errors = said(arguments)
    wrong = _wrong(code, errors) + (_differing(out, whole) if code == 0 else [])
    return Attempt("TMPDIR", size, code, "; ".join(wrong))


def _differing(out: Path, whole: dict[str, str]) -> list[str]:
    now = results(out)
    return [f"{name} differs" for name in sorted({*now, *whole}) if now.get(name) != whole.get(name)]


def _wrong(code: int, errors: str) -> list[str]:
    if code == 0:
        return []
    if code != 2 or "Traceback" in errors or errors.count("\n") != 1:
        return [f"exit code {code}: {errors[-300:]}"]
    return [] if re.search(r"error: /\S+.*MB are free", errors) else [f"neither file nor space is named: {errors}"]


@contextlib.contextmanager
def _temporary(folder: Path) -> Iterator[None]:
    before, old = tempfile.tempdir, os.environ.get("TMPDIR")
    tempfile.tempdir = None
    os.environ["TMPDIR"] = str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = before
        os.environ.pop("TMPDIR")
        if old is not None:
            os.environ["TMPDIR"] = old


def said(arguments: list[str]) -> tuple[int, str]:
    """The exit code of a command in this process, and what it wrote to stderr."""
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors):
        code = recorded(arguments)[1]
    return code, errors.getvalue()


def table(attempts: list[Attempt]) -> str:
    """A row a place, and each attempt that had something wrong."""
    lines = ["| place | sizes | from | to | exit code 2 | exit code 0 | wrong |", "|---|--:|--:|--:|--:|--:|--:|"]
    for what in dict.fromkeys(a.what for a in attempts):
        some = [a for a in attempts if a.what == what]
        sizes, codes = [a.size for a in some], [sum(a.code == code for a in some) for code in (2, 0)]
        wrong = sum(bool(a.wrong) for a in some)
        lines.append(f"| {what} | {len(some)} | {min(sizes):,} | {max(sizes):,} | {codes[0]} | {codes[1]} | {wrong} |")
    return "\n".join([*lines, *(f"{a.what} on {a.size:,} bytes: {a.wrong}" for a in attempts if a.wrong)])
