"""SIGTERM ends work as Ctrl-C does."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress

import pytest

from rtgs.base.events import ResultLine, WorkFinished, WorkProgress, WorkStarted
from rtgs.cli.signals import Terminated, sigterm_as_ctrl_c


def test_sigterm_raises_where_the_work_is() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt) as stop, sigterm_as_ctrl_c():
        os.kill(os.getpid(), signal.SIGTERM)
    assert isinstance(stop.value, Terminated)
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_second_sigterm_does_not_disturb_the_end_of_the_work() -> None:
    ended = False
    with pytest.raises(Terminated), sigterm_as_ctrl_c():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        finally:
            os.kill(os.getpid(), signal.SIGTERM)
            ended = True
    assert ended


def test_a_sigterm_that_went_under_stops_the_work_at_its_next_step() -> None:
    """As it does where it came in a destructor: Python drops the exception there."""
    with sigterm_as_ctrl_c() as listener:
        with pytest.raises(Terminated):
            with suppress(Terminated):
                os.kill(os.getpid(), signal.SIGTERM)
            listener(ResultLine("a result is still shown"))
            listener(WorkFinished("rgb", 1.0, False))
            listener(WorkProgress("rgb", 2, 3, ""))
        with pytest.raises(Terminated):
            listener(WorkStarted("scale", "metric scale"))


def test_without_sigterm_the_listener_does_nothing() -> None:
    with sigterm_as_ctrl_c() as listener:
        listener(WorkStarted("rgb", "RGB model"))
        listener(WorkProgress("rgb", 1, 2, ""))


def test_another_thread_than_the_main_one_has_no_handler() -> None:
    seen: list[object] = []

    def work() -> None:
        with sigterm_as_ctrl_c() as listener:
            listener(WorkStarted("rgb", "RGB model"))
            seen.append(signal.getsignal(signal.SIGTERM))

    before = signal.getsignal(signal.SIGTERM)
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [before]
