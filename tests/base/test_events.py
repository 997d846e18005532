"""Events of long work."""

from __future__ import annotations

import pytest

from rtgs.base.events import Event, ResultLine, WorkFinished, WorkProgress, WorkStarted, long_work, nobody, to_all


def test_long_work_tells_its_start_its_steps_and_its_end() -> None:
    events: list[Event] = []
    with long_work(events.append, "import", "import flir") as progress:
        progress(1, 2, "a.jpg")
        progress(2, 2, "b.jpg")
    *before, end = events
    assert before == [
        WorkStarted("import", "import flir"),
        WorkProgress("import", 1, 2, "a.jpg"),
        WorkProgress("import", 2, 2, "b.jpg"),
    ]
    assert isinstance(end, WorkFinished) and end.name == "import" and end.completed and end.seconds >= 0


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_work_that_fails_ends_uncompleted(error: type[BaseException]) -> None:
    events: list[Event] = []
    with pytest.raises(error), long_work(events.append, "a", "b"):
        raise error
    assert isinstance(events[-1], WorkFinished) and not events[-1].completed


def test_a_listener_can_stop_the_work() -> None:
    events: list[Event] = []

    def stopper(event: Event) -> None:
        if isinstance(event, WorkProgress) and event.done == 2:
            raise KeyboardInterrupt

    steps = []
    with pytest.raises(KeyboardInterrupt), long_work(to_all(events.append, stopper), "a", "b") as progress:
        for step in range(5):
            progress(step, 5, "")
            steps.append(step)
    assert steps == [0, 1] and isinstance(events[-1], WorkFinished)


def test_all_listeners_hear_everything_in_their_order() -> None:
    heard: list[tuple[str, Event]] = []
    listener = to_all(lambda e: heard.append(("first", e)), nobody, lambda e: heard.append(("second", e)))
    listener(ResultLine("found"))
    assert heard == [("first", ResultLine("found")), ("second", ResultLine("found"))]
