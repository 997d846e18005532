"""`rtgs experiment`: the paper's tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from rtgs.base.events import ResultLine, long_work
from rtgs.cli.options import Flat, Folder, Hidden
from rtgs.config import RealExperimentConfig, SyntheticExperimentConfig


def experiment() -> None:
    """Tables beside rival methods: `rtgs experiment synthetic --out DIR`, ..."""
    raise AssertionError("`main` takes the commands behind `rtgs experiment` from a table of their own")


def synthetic(out: Path, config: Annotated[SyntheticExperimentConfig, Flat], listener: Hidden) -> None:
    """How well the scale is found on synthetic scenes, by this method and by its rivals.

    What an earlier call with the same settings has left in the folder is kept. To have one method done again, remove its records:
    DIR/records/*.ours.json.

    Args:
        out: folder for scenes, records, tables and figures.
        config: settings.
    """
    from rtgs.experiments.synthetic import synthetic_experiment

    with long_work(listener, "experiment", "experiment synthetic") as progress:
        files = synthetic_experiment(out, config, progress=progress)
    for path in files:
        listener(ResultLine(f"wrote {path}"))


def real(source: Folder, out: Path, config: Annotated[RealExperimentConfig, Flat], listener: Hidden) -> None:
    """What a scale does to temperatures: thermal models at scales found in several ways, scored on held-out views of one capture.

    Rows that an earlier call with the same inputs has made are not made again. A row that cannot run is listed with the reason.

    Args:
        source: a run folder, or a capture, which is run first (to OUT/run).
        out: folder for the tables and pictures.
        config: settings.
    """
    from rtgs.experiments.real import real_experiment

    for path in real_experiment(source, out, config, listener):
        listener(ResultLine(f"wrote {path}"))
