"""SIGTERM ends work as Ctrl-C does."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress
from pathlib import Path

import pytest

from rtgs.base.errors import RtgsError
from rtgs.base.events import Event, ResultLine, WorkFinished, WorkProgress, WorkStarted
from rtgs.cli import main
from rtgs.cli.signals import Terminated, sigterm_as_ctrl_c, stop_behind


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


def test_without_sigterm_the_work_goes_on() -> None:
    before, ended = signal.getsignal(signal.SIGTERM), False
    with sigterm_as_ctrl_c() as listener:
        listener(WorkStarted("rgb", "RGB model"))
        listener(WorkProgress("rgb", 1, 2, ""))
        ended = True
    assert ended and signal.getsignal(signal.SIGTERM) is before


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


@pytest.mark.parametrize(("stop", "code"), [(KeyboardInterrupt, 130), (Terminated, 143)])
@pytest.mark.parametrize("hidden_by", [SystemError, AttributeError, RtgsError, OSError])
def test_a_stop_that_another_error_hides_is_still_a_stop(
    stop: type[KeyboardInterrupt], code: int, hidden_by: type[Exception], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As where a signal comes during an import or a callback from C: the caller sees an error of that code."""

    def listener(event: Event) -> None:
        if isinstance(event, WorkStarted):
            try:
                raise stop
            except KeyboardInterrupt as error:
                raise hidden_by("returned a result with an exception set") from error

    with pytest.raises(SystemExit) as ended:
        main(["synth", "--out", str(tmp_path / "capture"), "--frames", "3", "--size", "8"], listener)
    assert ended.value.code == code
    assert capsys.readouterr().err.strip() == "stopped"  # this command begins anew


def test_a_stopped_run_says_that_it_can_go_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def listener(event: Event) -> None:
        raise KeyboardInterrupt

    with pytest.raises(SystemExit):
        main(["demo", "--out", str(tmp_path)], listener)
    assert "the same command goes on" in capsys.readouterr().err


def test_an_error_without_a_stop_is_none() -> None:
    try:
        try:
            raise ValueError
        except ValueError as first:
            raise RuntimeError from first
    except RuntimeError as error:
        assert stop_behind(error) is None
