"""COLMAP in a process of its own, which it may end.

COLMAP aborts its process where SQLite cannot write, as on a full disk. Then this process goes on, and says what happened. The other one
gets its task through stdin and answers through stdout, both pickled. When its stdin is closed, as by the death of this process, it ends.
"""

from __future__ import annotations

import os
import pickle
import re
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from typing import IO, Any

from rtgs.base.errors import RtgsError
from rtgs.base.files import room_in
from rtgs.base.progress import Progress
from rtgs.sfm.colmap_job import Found, Task, do

_MAIN = f"from {__name__} import main; main()"


def do_apart(task: Task, report: Progress) -> Found:
    """`colmap_job.do` in another process, which ends when an exception is raised here.

    Args:
        report: called in this thread, several times a second.

    Raises:
        RtgsError: as `do`, or COLMAP has ended its process.
    """
    places = os.pathsep.join(path for path in sys.path if path)
    environment = {**os.environ, "PYTHONPATH": places, "PYTHONSAFEPATH": "1"}  # not the folder that it is started in
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", _MAIN], stdin=pipe, stdout=pipe, stderr=pipe, env=environment) as process:
        assert process.stdin is not None and process.stdout is not None and process.stderr is not None
        said: list[bytes] = []
        listener = threading.Thread(target=lambda file: said.append(file.read()), args=(process.stderr,))
        listener.start()
        try:
            answer = _answer(task, report, process.stdin, process.stdout)
        finally:
            process.kill()  # it has answered, or is not wanted any more
            listener.join()
    if isinstance(answer, Found):
        return answer
    raise RtgsError(answer or _why(task, process.returncode, said[0].decode("utf-8", "replace")))


def _answer(task: Task, report: Progress, to_other: IO[bytes], from_other: IO[bytes]) -> Found | str | None:
    """What was found, or the other process's refusal; None where it ended without either."""
    with suppress(BrokenPipeError):  # it has ended already
        pickle.dump(task, to_other)
        to_other.flush()
    while True:
        try:
            message = pickle.load(from_other)
        except (EOFError, pickle.UnpicklingError):  # it has ended, perhaps in the middle of a message
            return None
        if not isinstance(message, tuple):
            return message
        report(*message)


def _why(task: Task, code: int, said: str) -> str:
    """Why COLMAP has ended, and what to do."""
    ended = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
    words = re.search(r"\[?\w+\.cc:\d+\] (.{1,200})", said)  # COLMAP's messages begin with a place in its source
    said = f" ({words[1]})" if words else ""
    return (
        f"{task.work_dir / 'database.db'}: COLMAP {ended}{said}. {room_in(task.work_dir)}. If that is little, make room or "
        "choose another place for the run; if memory ran out, lower --sfm.max-image-side."
    )


def main() -> None:
    """The other process: a task from stdin; progress, and what was found or a refusal, to stdout."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both processes; the first one decides
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not get between the answers
    task = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_stdin, daemon=True).start()

    def tell(message: Any) -> None:
        pickle.dump(message, answers)
        answers.flush()

    try:
        tell(do(task, lambda done, total, text: tell((done, total, text))))
    except RtgsError as error:
        tell(str(error))


def _end_with_stdin() -> None:
    sys.stdin.buffer.read(1)
    os._exit(1)
