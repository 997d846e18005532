"""One writer a run folder: a lock that the operating system releases when its holder ends, however it ends."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.files import recover, remove
from rtgs.run.swap import complete_replacement

try:
    import fcntl
except ImportError:  # Windows has no flock: runs are not locked there
    fcntl = None  # type: ignore[assignment]

NAME = ".lock"
_TEMPORARY = ".*.tmp"  # of `write_whole`


@contextmanager
def locked(run: Path) -> Iterator[None]:
    """Hold the run folder for this process alone. What killed writers left in it is removed.

    The folder is made if there is none, and is gone afterwards if it is still empty then.

    The lock is on the open file and not on its existence, so the file of a process that was killed locks nobody out.

    Raises:
        RtgsError: another process holds it; the message names that process.
    """
    found = run.exists()
    run.mkdir(parents=True, exist_ok=True)
    path = run / NAME
    file = _take(run, path)
    try:
        _remove_leftovers(run)
        yield
    finally:
        path.unlink(missing_ok=True)  # before it is released: nobody else may hold what is removed
        os.close(file)
        if not found:
            with suppress(OSError):  # there are results in it
                run.rmdir()


def is_leftover(path: Path) -> bool:
    """Whether a file in a run folder is only what a killed writer has left."""
    return path.name == NAME or path.match(_TEMPORARY)


def _take(run: Path, path: Path) -> int:
    """The lock file, open and locked, with this process named in it."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            if fcntl is not None:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The holder before us may have removed the file between our opening and our locking it: then we hold a lock on nothing.
            if path.exists() and os.path.samestat(os.fstat(file), path.stat()):
                os.ftruncate(file, 0)
                os.pwrite(file, f"{os.getpid()}\n{_command()}\n".encode(), 0)
                return file
        except BlockingIOError:
            holder = os.pread(file, 10_000, 0).decode(errors="replace").split("\n")
            os.close(file)
            raise RtgsError(f"{run}: {_said_of(holder)} is writing to this run. Wait until it has ended, or stop it.") from None
        except BaseException:
            os.close(file)
            raise
        os.close(file)


def _command() -> str:
    program = Path(sys.argv[0])
    name = program.parent.name if program.name == "__main__.py" else program.name  # `python -m rtgs` is `rtgs`
    return shlex.join([name, *sys.argv[1:]])


def _said_of(holder: list[str]) -> str:
    if len(holder) < 2 or not holder[0].isdigit():  # it has locked the file and not yet written its name
        return "another process"
    return f"process {holder[0]} (`{holder[1]}`)"


def _remove_leftovers(run: Path) -> None:
    """Temporary files of `write_whole` whose process was killed. Results that were being replaced are put in place."""
    complete_replacement(run)
    for path in run.glob(_TEMPORARY):
        *name, writer = path.name.removesuffix(".tmp").removeprefix(".").split(".")
        if writer == "old":
            recover(run / ".".join(name))
        elif writer.isdigit() and int(writer) != os.getpid() and _is_alive(int(writer)):
            continue  # a report is written without the lock
        remove(path)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # somebody else's
        return True
    return True
