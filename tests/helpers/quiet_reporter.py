"""A `Reporter` that keeps what it is told."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rtgs.base.progress import Progress


class Quiet:
    """Titles of pieces of work, and lines of results. Where a title is `stop`, it stops the work as Ctrl-C does."""

    def __init__(self, stop: str = "") -> None:
        self.stop = stop
        self.titles: list[str] = []
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)

    @contextmanager
    def stage(self, title: str) -> Iterator[Progress]:
        if title == self.stop:
            raise KeyboardInterrupt
        self.titles.append(title)
        yield lambda done, total, text: None
