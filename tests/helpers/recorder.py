"""A listener that remembers."""

from __future__ import annotations

from rtgs.base.events import Event, ResultLine, WarningLine, WorkProgress, WorkStarted


class Recorder:
    """A listener that remembers, and can press Ctrl-C at the n-th step of one piece of work."""

    def __init__(self, stop_in: str | None = None, stop_at: int = 1) -> None:
        self.stop_in, self.stop_at = stop_in, stop_at
        self.events: list[Event] = []
        self.first_step: dict[str, int] = {}

    def __call__(self, event: Event) -> None:
        self.events.append(event)
        if isinstance(event, WorkProgress):
            self.first_step.setdefault(event.name, event.done)
            if event.name == self.stop_in and event.done >= self.stop_at:
                raise KeyboardInterrupt

    @property
    def works(self) -> list[str]:
        """Names of the pieces of work that were begun."""
        return [e.name for e in self.events if isinstance(e, WorkStarted)]

    @property
    def titles(self) -> list[str]:
        """Their titles."""
        return [e.title for e in self.events if isinstance(e, WorkStarted)]

    @property
    def lines(self) -> list[str]:
        """Results and warnings."""
        return [e.text for e in self.events if isinstance(e, ResultLine | WarningLine)]
