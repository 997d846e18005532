"""The main job: from a capture folder to a metric thermal model, stage by stage, resumable."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

from rtgs.base.errors import RtgsError
from rtgs.base.events import Listener, ResultLine, nobody
from rtgs.config import RunConfig
from rtgs.records.capture import Capture
from rtgs.renderer import check_backend
from rtgs.rgb.imported import model_from_ply
from rtgs.run.config_file import SavedRun
from rtgs.run.content import Content, Hashes, read_content
from rtgs.run.folder import RunFolder
from rtgs.run.job import Job
from rtgs.run.lock import is_leftover, locked
from rtgs.run.stages import STAGES, Stage, StageName, fingerprints


class Pipeline:
    """A run folder and the stages that fill it. `start`, `open` and `change` give one, with the run's lock held in their `with` block.

    Attributes:
        folder: the run; its `config.json` says which capture and which settings.
        listener: gets the events of the work.
        stages: what is done, in this order.
    """

    def __init__(self, folder: RunFolder, listener: Listener = nobody, stages: Sequence[Stage] = STAGES) -> None:
        self.folder, self.listener, self.stages = folder, listener, tuple(stages)
        self.saved = folder.read_config()

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
        _check_settings(config, folder)
        with locked(out):
            hashes = Hashes(out)
            content = read_content(capture, config.rgb_ply and config.rgb_ply.resolve(), hashes)
            if folder.exists():
                _check_same_capture(capture, content, folder)
            folder.write_config(SavedRun(capture.resolve(), config, content.capture_hash))
            hashes.write()
            yield Pipeline(folder, listener, stages)

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
            folder.write_config(replace(saved, config=replace(saved.config, **settings)))
            yield Pipeline(folder, listener)

    @cached_property
    def capture(self) -> Capture:
        """The run's capture, loaded when it is first asked for."""
        return self.folder.load_capture(self.listener)

    def fingerprints(self) -> dict[StageName, str]:
        """What each stage depends on as of now, as hashes.

        Raises:
            RtgsError: the capture, or the model to import, has gone.
        """
        self.folder.check_capture(self.saved)
        hashes = Hashes(self.folder.path)
        content = read_content(self.saved.capture, self.saved.config.rgb_ply, hashes)
        hashes.write()
        return fingerprints(content, self.saved.config, self.stages)

    def run(self, last: StageName = "evaluate", *, again: bool = False) -> None:
        """Do every stage up to `last` that is not complete; with `again`, `last` itself in any case.

        Raises:
            RtgsError: the capture has gone, or a stage cannot use what it is given.
        """
        now = self.fingerprints()  # before anything of the run is given up
        for i, stage in enumerate(self.stages):
            fingerprint = now[stage.name]
            if self.folder.is_complete(stage, fingerprint) and not (again and stage.name == last):
                self.listener(ResultLine(f"{stage.name}: done before"))
            else:
                self.folder.begin(self.stages[i:], fingerprint)
                job = Job(self.folder, self.saved.config, self.capture, self.listener)
                stage.work(job)
                self.folder.finish(stage, fingerprint, job.seconds)
            if stage.name == last:
                return


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
