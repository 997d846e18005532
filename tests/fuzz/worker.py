"""One process of a fuzz campaign: reads inputs one after the other within bounds of time and memory, and tells of each.

A case that does not end, or takes more memory than it may, ends this process. Whoever started it sees that, and knows the case.

    python -m tests.fuzz.worker FOLDER READER SEED COUNT [READER SEED COUNT …]
"""

from __future__ import annotations

import contextlib
import os
import re
import resource
import signal
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path

from tests.fuzz.examples import write_folder
from tests.fuzz.readers import READERS, Reader, input_of

from rtgs.base.errors import RtgsError

SECONDS, BYTES = 20, 10**9
_STARTS = (
    "subprocess.Popen",
    "os.exec",
    "os.fork",
    "os.forkpty",
    "os.posix_spawn",
    "os.spawn",
    "os.system",
    "pty.spawn",
    "socket.",
)


class Forbidden(Exception):
    """A process was started, or a socket opened."""


def forbid_processes() -> None:
    """From here on, starting a process or opening a socket raises. There is no way back in this process."""

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event.startswith(_STARTS):
            raise Forbidden(f"{event} {arguments!r:.200}")

    sys.addaudithook(hook)


def limit_memory() -> None:
    """Let this process have `BYTES` more of address space than it has now."""
    status = Path("/proc/self/status").read_text()
    now = 1024 * int(re.findall(r"VmSize:\s+(\d+) kB", status)[0])
    resource.setrlimit(resource.RLIMIT_AS, (now + BYTES, resource.RLIM_INFINITY))


def outcome(reader: Reader, seed: int, root: Path) -> str:
    """ "accepted", "refused", or what went wrong in one line."""
    try:
        input_of(reader, seed, root)
    except Exception as error:  # a defect of these tests
        return f"wrong: no input could be made: {error!r:.300}"
    signal.alarm(SECONDS)  # not caught: it has to end work of C too
    try:
        reader.read(root)
    except RtgsError as refusal:
        text = str(refusal)
        if "\n" in text or not text.strip() or len(text) > 3000:
            return f"wrong: a message of {text.count(chr(10)) + 1} lines, {len(text)} characters: {text!r:.300}"
        return "refused"
    except BaseException as error:  # a defect: this is what the campaign looks for
        where = traceback.extract_tb(error.__traceback__)
        ours = [f"{Path(f.filename).name}:{f.lineno}" for f in where if f"{os.sep}rtgs{os.sep}" in f.filename]
        return f"wrong: {type(error).__name__}: {str(error)!r:.200} at {' '.join(ours[-4:])}"
    finally:
        signal.alarm(0)
    return "accepted"


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """What libraries print goes nowhere."""
    with Path(os.devnull).open("w") as nowhere, contextlib.redirect_stderr(nowhere):
        yield


def main(arguments: list[str]) -> None:
    """Do the cases that the arguments name, a line on stdout for each: the reader's number, the seed, the outcome."""
    root = Path(arguments[0]) / "case"
    out = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    for reader in READERS:  # compiles kernels and loads modules, which takes time and memory that no input is to blame for
        if reader.warm_up is not None:
            write_folder(root, reader.warm_up()[0])
            reader.read(root)
    forbid_processes()
    limit_memory()
    jobs = [(int(r), int(s), int(n)) for r, s, n in zip(arguments[1::3], arguments[2::3], arguments[3::3], strict=True)]
    with quiet():
        for number, first, count in jobs:
            for seed in range(first, first + count):
                print(number, seed, "began", file=out)
                print(number, seed, outcome(READERS[number], seed, root), file=out)


if __name__ == "__main__":
    main(sys.argv[1:])
