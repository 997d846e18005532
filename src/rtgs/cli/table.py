"""The commands, by name, with the defaults of their settings filled in."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

from rtgs.base.events import Listener
from rtgs.cli.commands.calibrate import calibrate, from_run, target
from rtgs.cli.commands.convert import import_photographs, make_synthetic
from rtgs.cli.commands.demo import demo
from rtgs.cli.commands.doctor import doctor
from rtgs.cli.commands.experiment import experiment, real, synthetic
from rtgs.cli.commands.info import info
from rtgs.cli.commands.report import report
from rtgs.cli.commands.results import export_models, render_images, share, spots
from rtgs.cli.commands.run import rgb, run, scale, score, sfm, thermal
from rtgs.cli.commands.view import view
from rtgs.config import ExportConfig, RealExperimentConfig, RunConfig, SpotsConfig, SynthConfig, SyntheticExperimentConfig

Commands: TypeAlias = dict[str, Callable[..., Any]]

FROM_RUN = "from-run"
"""The command behind `rtgs calibrate` that needs no name: `rtgs calibrate RUN`."""


def all_commands(saved: RunConfig, listener: Listener, *, as_json: bool = False) -> Commands:
    """All commands.

    Args:
        saved: settings of the run that the command line names, which are the defaults of its flags.
        listener: gets the events of the work.
        as_json: results are wanted as JSON.
    """
    table: Commands = {
        "run": partial(run, config=saved),
        "sfm": partial(sfm, config=saved.sfm, rgb_max_side=saved.rgb_max_side, saved=saved),
        "rgb": partial(rgb, config=saved.rgb, rgb_ply=saved.rgb_ply),
        "scale": partial(scale, config=saved.scale),
        "thermal": partial(thermal, config=saved.thermal),
        "eval": score,
        "doctor": partial(doctor, as_json=as_json),
        "render": render_images,
        "spots": partial(spots, config=SpotsConfig()),
        "view": view,
        "export": partial(export_models, config=ExportConfig()),
        "share": share,
        "report": report,
        "info": partial(info, as_json=as_json),
        "import": import_photographs,
        "synth": partial(make_synthetic, config=SynthConfig()),
        "demo": demo,
    }
    return {name: partial(command, listener=listener) for name, command in table.items()} | {
        "calibrate": calibrate,
        "experiment": experiment,
    }


def experiment_commands(listener: Listener) -> Commands:
    """The commands behind `rtgs experiment`."""
    return {
        "synthetic": partial(synthetic, config=SyntheticExperimentConfig(), listener=listener),
        "real": partial(real, config=RealExperimentConfig(), listener=listener),
    }


def calibrate_commands(listener: Listener) -> Commands:
    """The commands behind `rtgs calibrate`."""
    return {"target": partial(target, listener=listener), FROM_RUN: partial(from_run, listener=listener)}
