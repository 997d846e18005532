"""Events of long work, shown on a terminal."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.text import Text

from rtgs.base.events import Event, ResultLine, WarningLine, WorkFinished, WorkProgress, WorkStarted


def clock(seconds: float | None) -> str:
    """ "0:07", "6:26" or "1:02:03" of a number of seconds; "–:––" where it is not known."""
    if seconds is None:
        return "–:––"
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


class _Times(ProgressColumn):
    """ "6:26 taken, 0:14 left"; once all is done only the time taken."""

    max_refresh = 0.5  # seconds

    def render(self, task: Task) -> Text:
        if task.finished:
            return Text(f"{clock(task.finished_time)} taken", style="progress.elapsed")
        return Text(f"{clock(task.elapsed)} taken, {clock(task.time_remaining)} left", style="progress.elapsed")


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Leave it to the command line; rich would end the process with exit code 1."""
        raise BrokenPipeError


class Terminal:
    """A listener that shows a bar with the time taken and left while work goes on, and results and warnings a line each."""

    def __init__(self) -> None:
        self._console = _Console()
        self._bar: Progress | None = None
        self._task = TaskID(0)

    def __call__(self, event: Event) -> None:
        match event:
            case WorkStarted():
                self._start(event.title)
            case WorkProgress() if self._bar is not None:
                self._bar.update(self._task, completed=event.done, total=event.total, text=event.text)
            case WorkFinished() if self._bar is not None:
                self._bar.stop()
                self._bar = None
            case ResultLine():
                self._print(event.text)
            case WarningLine():
                self._print(f"warning: {event.text}")

    def _start(self, title: str) -> None:
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=16),
            MofNCompleteColumn(),
            _Times(),
            TextColumn("{task.fields[text]}", style="dim", markup=False),
            console=self._console,
        )
        self._task = self._bar.add_task(title, total=None, text="")
        self._bar.start()

    def _print(self, text: str) -> None:
        self._console.print(text, markup=False, emoji=False, highlight=False, soft_wrap=True)  # a path may hold [brackets]
