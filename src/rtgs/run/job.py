"""What the work of a stage is given."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from rtgs.base.events import Listener, ResultLine, WarningLine, long_work
from rtgs.base.files import remove
from rtgs.base.memory import Memory, release
from rtgs.base.progress import Progress
from rtgs.config import RunConfig
from rtgs.records.capture import Capture
from rtgs.records.scene import Scene
from rtgs.run.folder import RunFolder
from rtgs.run.stages import Stage


@dataclass(eq=False)
class Job:
    """One stage of one run.

    Attributes:
        folder: the run, for reading what the stages before have made. Results of an earlier call of this stage are still there.
        results: where this stage writes to; all of it is put in place when the stage has ended.
        seconds: piece of work → how long it took; `work` fills it.
    """

    folder: RunFolder
    results: RunFolder
    stage: Stage
    config: RunConfig
    capture: Capture
    listener: Listener
    seconds: dict[str, float] = field(default_factory=dict)

    @cached_property
    def scene(self) -> Scene:
        """As it is on disk when the stage begins: a resumed run sees the very same numbers as one that was not interrupted."""
        return self.folder.read_scene(self.capture, refined=self.stage.sees_refined_rig)

    @cached_property
    def memory(self) -> Memory:
        """What this run may take."""
        return Memory.of(self.config.memory_gb)

    @contextmanager
    def work(self, name: str, title: str) -> Iterator[Progress]:
        """A piece of long work, told to the listener and timed."""
        start = time.perf_counter()
        with long_work(self.listener, name, title) as progress:
            yield progress
        self.seconds[name] = time.perf_counter() - start
        self.capture.release_images()
        release()  # what this work has needed is not added to what the next one needs

    @contextmanager
    def work_files(self, name: str) -> Iterator[Path]:
        """A place in the run folder for files that are removed when the block ends. Nothing is there yet."""
        folder = self.folder.path / f".{name}.tmp"
        remove(folder)
        try:
            yield folder
        finally:
            remove(folder)

    def say(self, text: str) -> None:
        """A line of result."""
        self.listener(ResultLine(text))

    def warn(self, text: str) -> None:
        """Something that a person should know."""
        self.listener(WarningLine(text))
