"""The progress of a search, in pictures rendered."""

from __future__ import annotations

from rtgs.base.progress import Progress


class RenderProgress:
    """Counts pictures as they are rendered and passes the count on to a progress bar. It changes nothing in the results.

    Args:
        listener: called with (pictures rendered, pictures in all as far as is known, text); None: only counted.
    """

    def __init__(self, listener: Progress | None) -> None:
        self._listener, self._done, self._total = listener, 0, 0

    def plan(self, remaining: int) -> None:
        """Say how many pictures are still to come, as far as is known."""
        self._total = self._done + remaining

    def __call__(self, text: str) -> None:
        """One picture more."""
        self._done += 1
        if self._listener is not None:
            self._listener(self._done, max(self._total, self._done), text)
