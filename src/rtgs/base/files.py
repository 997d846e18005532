"""Files and folders that are written whole or not at all, and hashes of what files hold."""

from __future__ import annotations

import hashlib
import math
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from errno import EDQUOT, EFBIG, EIO, ENOSPC
from pathlib import Path

from rtgs.base.errors import RtgsError


@contextmanager
def write_whole(path: Path) -> Iterator[Path]:
    """A place beside `path` to write to, a file or a folder, which becomes `path` when the block ends without an error.

    A reader sees the old content or the new one, never half of it: a file is renamed over the old one after it has reached the disk.
    A folder cannot replace another in one step; `recover` mends what a crash between the two steps leaves.

    Raises:
        OSError: as the writing does, with `path` as its file name; `path` is then as it was, and nothing is left beside it.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    remove(temporary)
    try:
        yield temporary
        if temporary.is_dir():
            old = _old(path)
            remove(old)
            if path.exists():
                path.rename(old)
            temporary.rename(path)
            remove(old)
        else:
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            temporary.replace(path)
    except OSError as error:
        if error.filename is None or str(error.filename) == str(temporary):
            # An error of a write, as on a full disk, names no file. NumPy's has no number either.
            raise OSError(error.errno or EIO, error.strerror or str(error), str(path)) from error
        raise
    finally:
        remove(temporary)


def write_text_whole(path: Path, text: str) -> None:
    """UTF-8 text, by `write_whole`."""
    with write_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def recover(path: Path) -> None:
    """Put a folder back that `write_whole` was replacing when the process was killed."""
    old = _old(path)
    if old.exists() and not path.exists():
        old.rename(path)


def _old(path: Path) -> Path:
    return path.with_name(f".{path.name}.old.tmp")


def remove(path: Path) -> None:
    """Remove a file, or a folder with what is in it; or nothing, where there is nothing."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def check_folder(path: Path) -> None:
    """Look whether `path` is a folder or can be made one, before work whose results go there.

    Raises:
        RtgsError: it is a file, or lies below one.
    """
    for place in (path, *path.parents):
        if place.is_dir():
            return
        if place.exists():
            raise RtgsError(f"{place}: is a file, and a folder is needed there. Name another folder.")


def room(folder: Path) -> float:
    """How many bytes a file in a folder may have: what is free on its disk, or the limit of this process where that is less."""
    return min(shutil.disk_usage(folder).free, _largest_file())


def room_in(folder: Path) -> str:
    """`room` in words, for a message."""
    free, limit = shutil.disk_usage(folder).free, _largest_file()
    said = f"{free / 1e6:,.1f} MB are free there"
    return said if free < limit else f"{said}, and a file of this process may have {limit / 1e6:,.1f} MB"


def reason(error: OSError) -> str:
    """Why a file could not be written or read; with the room there is where that is the reason."""
    said = error.strerror or str(error)
    if error.errno not in (ENOSPC, EDQUOT, EFBIG) or error.filename is None:
        return said
    folder = Path(error.filename).parent
    return f"{said} ({room_in(folder)})" if folder.is_dir() else said


def _largest_file() -> float:
    try:
        import resource
    except ImportError:  # Windows
        return math.inf
    soft = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    return math.inf if soft == resource.RLIM_INFINITY else soft


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's content, in hexadecimal digits.

    Raises:
        OSError: as reading does.
    """
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
