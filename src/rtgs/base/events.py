"""What long work tells while it goes on: small records that go to listeners, such as a terminal, a viewer or a cluster's driver."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeAlias

from rtgs.base.progress import Progress


@dataclass(frozen=True)
class WorkStarted:
    """A piece of long work begins: a stage of a run, or an import, an experiment, …

    Attributes:
        name: of the work, the same in all of its events; a stage's is also its key in the run's timings.
        title: for people.
    """

    name: str
    title: str


@dataclass(frozen=True)
class WorkProgress:
    """How far the work has come.

    Attributes:
        done, total: counted in whatever the work counts (steps, frames, …); `total` may change.
        text: what is going on, or "".
    """

    name: str
    done: int
    total: int
    text: str


@dataclass(frozen=True)
class ModelSnapshot:
    """The RGB model as it grows.

    Attributes:
        step: training steps so far.
        model: an `RgbModel` with tensors of its own, which later steps do not change.
    """

    name: str
    step: int
    model: Any


@dataclass(frozen=True)
class WarningLine:
    """Something that a person should know about the input or the result."""

    text: str


@dataclass(frozen=True)
class ResultLine:
    """A result in one line."""

    text: str


@dataclass(frozen=True)
class WorkFinished:
    """The work has ended.

    Attributes:
        seconds: how long it took.
        completed: False where it was cut off by an error or by the user.
    """

    name: str
    seconds: float
    completed: bool


Event: TypeAlias = WorkStarted | WorkProgress | ModelSnapshot | WarningLine | ResultLine | WorkFinished

Listener: TypeAlias = Callable[[Event], None]
"""Called in the thread that does the work, so it should return soon. An exception from it ends the work and is raised where the work was
called: a listener that raises `KeyboardInterrupt` stops a run as Ctrl-C does."""


def nobody(event: Event) -> None:
    """The listener of work that nobody watches."""


def to_all(*listeners: Listener) -> Listener:
    """One listener that passes every event on to several, in their order."""

    def listener(event: Event) -> None:
        for each in listeners:
            each(event)

    return listener


@contextmanager
def long_work(listener: Listener, name: str, title: str) -> Iterator[Progress]:
    """Tell a listener that a piece of work begins, how it goes, and that it has ended, with or without an error."""
    listener(WorkStarted(name, title))
    start = time.perf_counter()
    completed = False
    try:
        yield lambda done, total, text: listener(WorkProgress(name, done, total, text))
        completed = True
    finally:
        listener(WorkFinished(name, time.perf_counter() - start, completed))
