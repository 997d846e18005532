"""What the terminal shows while work goes on."""

from __future__ import annotations

import pytest

from rtgs.base.events import ResultLine, WorkFinished, WorkProgress, WorkStarted
from rtgs.cli.terminal import Terminal, clock


@pytest.mark.parametrize(("seconds", "shown"), [(0, "0:00"), (7.9, "0:07"), (386, "6:26"), (3723, "1:02:03"), (None, "–:––")])
def test_times_are_minutes_and_seconds(seconds: float | None, shown: str) -> None:
    assert clock(seconds) == shown


def test_a_finished_bar_says_how_long_the_work_took(capsys: pytest.CaptureFixture[str]) -> None:
    terminal = Terminal()
    for event in (
        WorkStarted("x", "metric scale"),
        WorkProgress("x", 3, 3, ""),
        WorkFinished("x", 0.1, True),
        ResultLine("scale: 2"),
    ):
        terminal(event)
    printed = capsys.readouterr().out
    assert "0:00 taken" in printed and "left" not in printed
    assert printed.endswith("scale: 2\n")
