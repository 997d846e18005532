"""`rtgs run`, and its stages one by one: `sfm`, `rgb`, `scale`, `thermal`, `eval`."""

from __future__ import annotations

from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from rtgs.base.events import Listener, ResultLine
from rtgs.cli.options import Flat, Folder, Hidden
from rtgs.config import RgbConfig, RunConfig, ScaleConfig, SfmConfig, ThermalConfig

if TYPE_CHECKING:
    from rtgs.run.pipeline import Pipeline
    from rtgs.run.stages import StageName


def run(capture: Folder, out: Path, config: Annotated[RunConfig, Flat], listener: Hidden) -> None:
    """The whole job: capture folder in, metric RGB and thermal models and a report out.

    Stages that an earlier call with the same settings has completed are not done again.

    Args:
        capture: folder with rgb/, thermal/ and rig.json, and poses if there are any.
        out: the run folder.
        config: settings.
    """
    from rtgs.run.pipeline import Pipeline

    with Pipeline.start(capture, out, config, listener) as pipeline:
        try:
            pipeline.examine()
            pipeline.run()
        except BaseException:
            if pipeline.accepted:  # else nothing has changed
                with suppress(Exception):  # the report of what is there must not hide why the work ended
                    _report(pipeline)
            raise
        _report(pipeline)


def sfm(
    capture: Folder,
    out: Path,
    config: Annotated[SfmConfig, Flat],
    rgb_max_side: int,
    saved: Annotated[RunConfig, tyro.conf.Suppress],
    listener: Hidden,
) -> None:
    """Start a run: RGB poses and sparse points, or the check of those that came with the capture.

    Args:
        capture: folder with rgb/, thermal/ and rig.json, and poses if there are any.
        out: the run folder.
        config: settings.
        rgb_max_side: RGB images are reduced to this many pixels on their longer side.
    """
    from rtgs.run.pipeline import Pipeline

    _stage(Pipeline.start(capture, out, replace(saved, sfm=config, rgb_max_side=rgb_max_side), listener), "sfm")


def rgb(run: Folder, config: Annotated[RgbConfig, Flat], rgb_ply: Path | None, listener: Hidden) -> None:
    """Train the RGB model, or import one.

    Args:
        run: the run folder.
        config: settings.
        rgb_ply: a trained 3DGS model in the frame and unit of the capture's poses, to use instead of training one.
    """
    _stage(_changed(run, listener, rgb=config, rgb_ply=rgb_ply), "rgb")


def scale(run: Folder, config: Annotated[ScaleConfig, Flat], listener: Hidden) -> None:
    """Find the metric scale.

    Args:
        run: the run folder.
        config: settings.
    """
    _stage(_changed(run, listener, scale=config), "scale")


def thermal(run: Folder, config: Annotated[ThermalConfig, Flat], listener: Hidden) -> None:
    """Fit the thermal model, and the control at scale 1.

    Args:
        run: the run folder.
        config: settings.
    """
    _stage(_changed(run, listener, thermal=config), "thermal")


def score(run: Folder, listener: Hidden) -> None:
    """Score held-out views, draw them, and write the report.

    Args:
        run: the run folder.
    """
    _stage(_changed(run, listener), "evaluate", again=True)


def _changed(run: Path, listener: Listener, **settings: Any) -> AbstractContextManager[Pipeline]:
    """An existing run with some settings replaced, and written down."""
    from rtgs.run.folder import RunFolder
    from rtgs.run.pipeline import Pipeline

    return Pipeline.change(RunFolder(run), listener, **settings)


def _stage(opened: AbstractContextManager[Pipeline], stage: StageName, *, again: bool = False) -> None:
    with opened as pipeline:
        pipeline.run(stage, again=again)
        _report(pipeline)


def _report(pipeline: Pipeline) -> None:
    from rtgs.run.report import write_report

    pipeline.listener(ResultLine(f"report: {write_report(pipeline.folder.path)}"))
