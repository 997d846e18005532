"""SIGTERM ends work as Ctrl-C does: cleanly, so that it can be resumed."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from rtgs.base.events import Event, Listener, WorkProgress, WorkStarted


class Terminated(KeyboardInterrupt):
    """The process got SIGTERM."""


@contextmanager
def sigterm_as_ctrl_c() -> Iterator[Listener]:
    """Raise `Terminated` in the main thread on the first SIGTERM; later ones are ignored, since the work is ending already.

    Gives a listener that raises it again at the next step of the work: Python drops an exception that a signal raises inside a destructor.
    """
    asked = False

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if not asked:
            asked = True
            raise Terminated

    def listener(event: Event) -> None:
        if asked and isinstance(event, WorkStarted | WorkProgress):
            raise Terminated

    if threading.current_thread() is not threading.main_thread():  # only the main thread can have handlers
        yield listener
        return
    before = signal.signal(signal.SIGTERM, handle)
    try:
        yield listener
    finally:
        signal.signal(signal.SIGTERM, before)


def stop_behind(error: BaseException) -> KeyboardInterrupt | None:
    """The Ctrl-C or SIGTERM that an error comes from, if any.

    A signal that arrives while C code calls back, or while a module is being imported, reaches the caller as an error of that code.
    """
    seen: set[int] = set()
    cause: BaseException | None = error
    while cause is not None and id(cause) not in seen:
        if isinstance(cause, KeyboardInterrupt):
            return cause
        seen.add(id(cause))
        cause = cause.__cause__ or cause.__context__
    return None
