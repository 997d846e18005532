"""Events of long work, shown on a terminal."""

from __future__ import annotations

import json

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.text import Text

from rtgs.base.events import Event, ResultLine, WarningLine, WorkFinished, WorkProgress, WorkStarted
from rtgs.cli.manners import Manners


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
    """A listener that shows a bar with the time taken and left while work goes on, and results and warnings a line each.

    Where the output is no terminal there are no bars and no colours: a line says how long each piece of work took.

    Args:
        manners: quiet: warnings alone; json: an object a line, without bars.
    """

    def __init__(self, manners: Manners | None = None) -> None:
        self._console = _Console()
        self._manners = manners or Manners()
        self._titles: dict[str, str] = {}
        self._bar: Progress | None = None
        self._task = TaskID(0)

    def __call__(self, event: Event) -> None:
        if self._manners.json:
            self._print_json(event)
            return
        if self._manners.quiet and not isinstance(event, WarningLine):
            return
        match event:
            case WorkStarted() if self._console.is_terminal:
                self._start(event.title)
            case WorkStarted():
                self._titles[event.name] = event.title
            case WorkProgress() if self._bar is not None:
                self._bar.update(self._task, completed=event.done, total=event.total, text=event.text)
            case WorkFinished() if self._bar is not None:
                self._bar.stop()
                self._bar = None
            case WorkFinished() if event.completed:
                self._print(f"{self._titles.get(event.name, event.name)}: {clock(event.seconds)} taken")
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

    def _print_json(self, event: Event) -> None:
        match event:
            case ResultLine():
                told: dict[str, object] = {"result": event.text.strip()}
            case WarningLine():
                told = {"warning": event.text}
            case WorkFinished():
                told = {"work": event.name, "seconds": round(event.seconds, 3), "completed": event.completed}
            case _:
                return
        if not (self._manners.quiet and "warning" not in told):
            self._print(json.dumps(told, ensure_ascii=False))

    def _print(self, text: str) -> None:
        self._console.print(text, markup=False, emoji=False, highlight=False, soft_wrap=True)  # a path may hold [brackets]
