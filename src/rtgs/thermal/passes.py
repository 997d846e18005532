"""Progress of a fit whose number of passes over the photographs is not known beforehand."""

from __future__ import annotations

from rtgs.base.progress import Progress


class Passes:
    """Counts the views that were rendered and tells a `Progress` of them.

    Args:
        total: views that most fits need. The count stops one short of it until `finish`.
        text: what is going on; it may change.
    """

    def __init__(self, total: int, progress: Progress | None, text: str = "") -> None:
        self.done, self.total, self.text, self._progress = 0, total, text, progress

    def __call__(self) -> None:
        self.done = min(self.done + 1, self.total - 1)
        if self._progress is not None:
            self._progress(self.done, self.total, self.text)

    def finish(self) -> None:
        if self._progress is not None:
            self._progress(self.total, self.total, self.text)
