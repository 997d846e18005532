"""The main job: from a capture folder to a metric thermal model, stage by stage, resumable."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

from rtgs.base.errors import RtgsError
from rtgs.base.events import Listener, ResultLine, WarningLine, nobody
from rtgs.config import RunConfig
from rtgs.doctor import examine
from rtgs.records.capture import Capture
from rtgs.renderer import check_backend
from rtgs.rgb.imported import model_from_ply
from rtgs.run.config_file import SavedRun, refuse_run
from rtgs.run.content import Content, Hashes, read_content
from rtgs.run.folder import RunFolder
from rtgs.run.job import Job
from rtgs.run.lock import is_leftover, locked
from rtgs.run.stages import STAGES, Stage, StageName, fingerprints
from rtgs.run.swap import new_results


class Pipeline:
    """A run folder and the stages that fill it. `start`, `open` and `change` give one, with the run's lock held in their `with` block.

    Attributes:
        folder: the run.
        listener: gets the events of the work.
        stages: what is done, in this order.
        saved: which capture and which settings. They are written to `config.json` when the first work begins, and so when they have been
            found to be usable.
        accepted: whether they have been written.
    """

    def __init__(
        self, folder: RunFolder, listener: Listener = nobody, stages: Sequence[Stage] = STAGES, saved: SavedRun | None = None
    ) -> None:
        self.folder, self.listener, self.stages = folder, listener, tuple(stages)
        self.saved = folder.read_config() if saved is None else saved
        self.accepted = False
        self._hashes = Hashes(folder.path)

    @staticmethod
    @contextmanager
    def start(
        capture: Path, out: Path, config: RunConfig, listener: Listener = nobody, stages: Sequence[Stage] = STAGES
    ) -> Iterator[Pipeline]:
        """Start a run of a capture, or go on with the one that is there.

        A capture that has been moved or copied is taken for the same one when its content is the same.

        Raises:
            RtgsError: `out` is the run of another capture, a folder of something else, inside the capture, or being written by
                another process; or the model to import is none.
        """
        folder = RunFolder(out)
        if out.resolve() == capture.resolve() or capture.resolve() in out.resolve().parents:
            raise RtgsError(f"--out {out}: lies inside the capture; results belong outside of it.")
        if folder.exists():
            folder.read_config()
        elif out.exists() and (not out.is_dir() or not all(is_leftover(p) for p in out.iterdir())):
            raise RtgsError(f"--out {out}: exists and is no run folder; choose another one.")
        if not capture.is_dir():
            raise RtgsError(f"{capture}: no such folder; a capture holds rgb/, thermal/ and rig.json.")
        refuse_run(capture)
        _check_settings(config, folder)
        config = replace(config, rgb_ply=config.rgb_ply and config.rgb_ply.resolve())
        with locked(out):
            pipeline = Pipeline(folder, listener, stages, SavedRun(capture.resolve(), config))
            content = pipeline.content()
            if folder.exists():
                _check_same_capture(capture, content, folder)
            pipeline.saved = replace(pipeline.saved, content=content.capture_hash)
            yield pipeline

    @staticmethod
    @contextmanager
    def open(folder: RunFolder, listener: Listener = nobody, stages: Sequence[Stage] = STAGES) -> Iterator[Pipeline]:
        """Go on with a run under its own settings.

        Raises:
            RtgsError: the folder holds no run, or another process is writing to it.
        """
        folder.read_config()
        with locked(folder.path):
            yield Pipeline(folder, listener, stages)

    @staticmethod
    @contextmanager
    def change(folder: RunFolder, listener: Listener = nobody, **settings: Any) -> Iterator[Pipeline]:
        """Go on with a run with some fields of its `RunConfig` replaced, and written down.

        Raises:
            RtgsError: the folder holds no run, another process is writing to it, or the model to import is none.
        """
        _check_settings(replace(folder.read_config().config, **settings), folder)
        with locked(folder.path):
            saved = folder.read_config()
            config = replace(saved.config, **settings)
            config = replace(config, rgb_ply=config.rgb_ply and config.rgb_ply.resolve())
            yield Pipeline(folder, listener, saved=replace(saved, config=config))

    @cached_property
    def capture(self) -> Capture:
        """The run's capture, loaded when it is first asked for."""
        return self.folder.load_capture(self.listener, self.saved)

    def content(self) -> Content:
        """What the capture, and the model to import, hold as of now.

        Raises:
            RtgsError: one of them has gone.
        """
        self.folder.check_capture(self.saved)
        return read_content(self.saved.capture, self.saved.config.rgb_ply, self._hashes)

    def fingerprints(self) -> dict[StageName, str]:
        """What each stage depends on as of now, as hashes.

        Raises:
            RtgsError: the capture, or the model to import, has gone.
        """
        return fingerprints(self.content(), self.saved.config, self.stages)

    def examine(self) -> None:
        """Say what is doubtful about the capture before the first work on it. Does nothing where that has been done.

        Raises:
            RtgsError: nothing can come of the capture.
        """
        first = self.stages[0]
        if self.folder.is_complete(first, self.fingerprints()[first.name]):
            return
        diagnosis = examine(self.capture)
        for finding in diagnosis.of("warning"):
            self.listener(WarningLine(f"{finding.text}. {finding.remedy}"))
        if errors := diagnosis.of("error"):
            raise RtgsError(f"{self.saved.capture}: {errors[0].text}. {errors[0].remedy}")

    def run(self, last: StageName = "evaluate", *, again: bool = False) -> None:
        """Do every stage up to `last` that is not complete; with `again`, `last` itself in any case.

        Input is checked before anything of the run is changed. Where the first work is refused all the same, the run has its earlier
        settings again.

        Raises:
            RtgsError: the capture has gone, or a stage cannot use what it is given.
        """
        now, earlier = self.fingerprints(), self.folder.read_config() if self.folder.exists() else None
        for i, stage in enumerate(self.stages):
            fingerprint = now[stage.name]
            if self.folder.is_complete(stage, fingerprint) and not (again and stage.name == last):
                self.folder.withdraw(stage)
                self.listener(ResultLine(f"{stage.name}: done before"))
            else:
                capture = self.capture  # is refused here if it cannot be read
                self._accept()
                try:
                    self._do(self.stages[i:], fingerprint, capture)
                except RtgsError:
                    if earlier is not None:
                        self.folder.withdraw(stage)
                        self.folder.write_config(earlier)
                    raise
                earlier = None  # there are results of these settings now
            if stage.name == last:
                break
        self._accept()

    def _accept(self) -> None:
        """Write down the settings, which have turned out to be usable."""
        if not self.accepted:
            self.folder.write_config(self.saved)
            self._hashes.write()
            self.accepted = True

    def _do(self, stages: Sequence[Stage], fingerprint: str, capture: Capture) -> None:
        """Do the first of these stages."""
        self.folder.begin(stages, fingerprint)
        with new_results(self.folder.path) as new:
            job = Job(self.folder, RunFolder(new), stages[0], self.saved.config, capture, self.listener)
            stages[0].work(job)
            self.folder.finish(stages, fingerprint, job.seconds)


def _check_same_capture(capture: Path, content: Content, folder: RunFolder) -> None:
    """Refuse another capture than the run's, however it is called."""
    saved = folder.read_config()
    if saved.capture == capture.resolve():
        return
    theirs = saved.content
    if not theirs and saved.capture.is_dir():  # started by an older version, which kept no hash
        theirs = read_content(saved.capture, None, Hashes(folder.path)).capture_hash
    if theirs != content.capture_hash:
        raise RtgsError(f"--out {folder.path}: is a run of {saved.capture}; choose another folder, or remove that one.")


def _check_settings(config: RunConfig, folder: RunFolder) -> None:
    """Refuse a model to import, or a back end, before any long work, and before the run is changed."""
    check_backend(config.rgb.backend)
    if config.rgb_ply is not None:
        if config.rgb_ply.resolve() == (folder.path / "rgb.ply").resolve():
            raise RtgsError(
                f"--rgb-ply {config.rgb_ply}: is the run's own model, which this run replaces; copy it elsewhere first."
            )
        model_from_ply(config.rgb_ply, 1.0)
