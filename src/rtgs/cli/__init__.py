"""The command line: `rtgs COMMAND`. No algorithm lives here, and a command imports what it runs: help should not wait for torch.

Exit codes: 0 done, 1 a defect of the program, 2 input that cannot be used (one message on stderr), 130 stopped with Ctrl-C.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

from rtgs import __version__
from rtgs.base.errors import RtgsError
from rtgs.base.json_records import read_run_json
from rtgs.base.progress import Progress
from rtgs.config import (
    RealExperimentConfig,
    RgbConfig,
    RunConfig,
    ScaleConfig,
    SfmConfig,
    SynthConfig,
    SyntheticExperimentConfig,
    ThermalConfig,
)
from rtgs.io.cameras.registry import MODULES as CAMERA_MODULES
from rtgs.run.config_file import is_run, read_config

if TYPE_CHECKING:
    from rtgs.run.pipeline import Pipeline, Stage

Folder = tyro.conf.Positional[Path]
Flat = tyro.conf.arg(name="")  # a config's fields become flags without a prefix

_ABOUT = "From synchronised RGB and thermal photographs to one metric 3D Gaussian model that renders both."
_ABOUT_EXPERIMENT = "The tables: this method and its rivals, on scenes whose truth is known and on captures."
_SYNTH = SynthConfig()
_EXPERIMENT_SYNTHETIC = SyntheticExperimentConfig()
_EXPERIMENT_REAL = RealExperimentConfig()
DEMO_CAPTURE = SynthConfig(scene="lego", frames=32, size=200, seed=3)
DEMO_RUN = RunConfig(rgb=RgbConfig(steps=1500))


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point of the `rtgs` command."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if arguments[:1] == ["--version"]:
        print(f"rtgs {__version__}")
        return
    try:
        commands, prog, about = _commands(_saved_settings(arguments)), "rtgs", _ABOUT
        if arguments[:1] == ["experiment"]:
            commands, prog, about, arguments = _experiments(), "rtgs experiment", _ABOUT_EXPERIMENT, arguments[1:]
        tyro.extras.subcommand_cli_from_dict(commands, prog=prog, description=about, args=arguments or ["--help"])
    except RtgsError as error:
        _complain(str(error))
        sys.exit(2)
    except OSError as error:  # a full disk, a folder that may not be written
        _complain(f"{error.filename}: {error.strerror}" if error.filename else str(error))
        sys.exit(2)
    except KeyboardInterrupt:
        Console(stderr=True).print("stopped; the same command goes on from here")
        sys.exit(130)


def _complain(text: str) -> None:
    console = Console(stderr=True)
    console.print("error:", style="bold red", end=" ")
    console.print(text, markup=False, emoji=False, highlight=False, soft_wrap=True)  # a path may hold [brackets]


def _saved_settings(arguments: Sequence[str]) -> RunConfig:
    """Settings of the run that the command line names: a flag changes one of them, the others stay as they were."""
    command, rest = arguments[0] if arguments else "", list(arguments[1:])
    named: list[str] = []
    if command in ("run", "sfm"):
        named = [rest[i + 1] for i, a in enumerate(rest[:-1]) if a == "--out"]
        named += [a.removeprefix("--out=") for a in rest if a.startswith("--out=")]
    elif command in ("rgb", "scale", "thermal"):
        named = rest  # the run is the positional one, before the flags or after them
    for candidate in named:
        if is_run(Path(candidate)):
            return read_config(Path(candidate))[1]
    return RunConfig()


def _commands(saved: RunConfig) -> dict[str, Callable[..., Any]]:
    def run(capture: Folder, out: Path, config: Annotated[RunConfig, Flat] = saved) -> None:
        """The whole job: capture folder in, metric RGB and thermal models and a report out.

        Stages that stand from an earlier call with the same settings are not done again.

        Args:
            capture: folder with rgb/, thermal/ and rig.json, and poses if there are any.
            out: the run folder.
            config: settings.
        """
        from rtgs.run.pipeline import Pipeline

        reporter = Terminal()
        pipeline = Pipeline.start(capture, out, config, reporter)
        try:
            pipeline.run()
        finally:
            _report(pipeline, reporter)

    def sfm(
        capture: Folder, out: Path, config: Annotated[SfmConfig, Flat] = saved.sfm, rgb_max_side: int = saved.rgb_max_side
    ) -> None:
        """Start a run: RGB poses and sparse points, or the check of those that came with the capture.

        Args:
            capture: folder with rgb/, thermal/ and rig.json, and poses if there are any.
            out: the run folder.
            config: settings.
            rgb_max_side: RGB images are reduced to this many pixels on their longer side.
        """
        from rtgs.run.pipeline import Pipeline

        settings = replace(saved, sfm=config, rgb_max_side=rgb_max_side)
        _stage(Pipeline.start(capture, out, settings, Terminal()), "sfm")

    def rgb(run: Folder, config: Annotated[RgbConfig, Flat] = saved.rgb, rgb_ply: Path | None = saved.rgb_ply) -> None:
        """Train the RGB model, or import one.

        Args:
            run: the run folder.
            config: settings.
            rgb_ply: a trained 3DGS model in the same world frame, to use instead of training one.
        """
        _stage(_changed(run, rgb=config, rgb_ply=rgb_ply), "rgb")

    def scale(run: Folder, config: Annotated[ScaleConfig, Flat] = saved.scale) -> None:
        """Find the metric scale.

        Args:
            run: the run folder.
            config: settings.
        """
        _stage(_changed(run, scale=config), "scale")

    def thermal(run: Folder, config: Annotated[ThermalConfig, Flat] = saved.thermal) -> None:
        """Fit the thermal model, and the control at scale 1.

        Args:
            run: the run folder.
            config: settings.
        """
        _stage(_changed(run, thermal=config), "thermal")

    def eval_(run: Folder) -> None:
        """Score held-out views, draw them, and write the report.

        Args:
            run: the run folder.
        """
        reporter = Terminal()
        pipeline = _opened(run, reporter)
        pipeline.run("evaluate", again=True)
        _report(pipeline, reporter)

    def render(
        run: Folder,
        out: Path,
        frames: tuple[str, ...] = (),
        viewpoint: Literal["rgb", "thermal"] = "rgb",
        emissivity: float | None = None,
        reflected_c: float | None = None,
    ) -> None:
        """Render RGB, temperature and depth from the cameras of a run.

        Args:
            run: the run folder.
            out: folder for NAME.rgb.png, NAME.thermal.png, NAME.thermal.tiff (°C) and NAME.depth.tiff (metres).
            frames: names of frames; all when none is given.
            viewpoint: whose camera to look through; everything is rendered from there, so it is aligned.
            emissivity: temperatures as under this emissivity of the object instead of that in rig.json; nothing is fitted again.
            reflected_c: likewise, under another apparent temperature of what the object reflects.
        """
        from rtgs.run.views import render_views

        reporter = Terminal()
        pipeline = _opened(run, reporter)
        with reporter.stage("views") as progress:
            render_views(
                pipeline.folder,
                pipeline.scene,
                out,
                frames,
                viewpoint=viewpoint,
                emissivity=emissivity,
                reflected_c=reflected_c,
                progress=progress,
            )
        reporter.say(f"views: {out}")

    def export_(run: Folder, out: Path, metres: bool = False) -> None:
        """Write the models and poses for other programs.

        Args:
            run: the run folder.
            out: folder for rgb.ply, thermal.ply, transforms.json and a COLMAP model.
            metres: lengths in metres instead of SfM units.
        """
        from rtgs.run.export import export

        reporter = Terminal()
        pipeline = _opened(run, reporter)
        for path in export(pipeline.folder, pipeline.scene, out, metres=metres):
            reporter.say(f"wrote {path}")
        estimate = pipeline.folder.read_scale()
        if metres and estimate.status != "ok":
            reporter.say(f"warning: these are hardly metres: {estimate.reason}")

    def import_(
        camera: tyro.conf.Positional[Literal[tuple(CAMERA_MODULES)]],  # type: ignore[valid-type]
        photographs: Folder,
        out: Path,
        rgb: Path | None = None,
        rig: Path | None = None,
    ) -> None:
        """Make a capture from a folder of radiometric JPEGs.

        Raw counts are kept with the camera's constants, so emissivity can still be changed: in the capture's rig.json.

        Args:
            camera: whose files they are.
            photographs: folder of radiometric JPEGs.
            out: the capture folder, new or empty.
            rgb: folder with visible pictures of the same names, for files that don't embed one.
            rig: a rig.json of this pair of cameras. Without one, what the files can't say is listed and has to be filled in.
        """
        from rtgs.io.cameras.import_folder import import_folder

        reporter = Terminal()
        with reporter.stage(f"import {camera}") as progress:
            result = import_folder(camera, photographs, out, rgb=rgb, rig=rig, progress=progress)
        reporter.say(f"import: {result.frames} pairs in {out}")
        for note in result.notes:
            reporter.say(f"note: {note}")
        if result.missing:
            reporter.say(f"{out / 'rig.json'} is a start. Before `rtgs run`, fill in:")
            for field in result.missing:
                reporter.say(f"  {field}")

    def synth(out: Path, config: Annotated[SynthConfig, Flat] = _SYNTH) -> None:
        """Make a synthetic capture with known truth.

        Args:
            out: the capture folder.
            config: settings.
        """
        from rtgs.synthetic import write_capture

        reporter = Terminal()
        with reporter.stage(f"synthetic {config.scene}") as progress:
            truth = write_capture(out, config, progress=lambda done, total: progress(done, total, ""))
        reporter.say(f"synth: {config.frames} pairs in {out}, true scale {truth.sfm_per_metre:.6g} SfM units per metre")

    def demo(out: Path = Path("rtgs-demo")) -> None:
        """See the whole method work: a small synthetic capture, a run, and the truth beside the result.

        Args:
            out: folder for the capture and the run.
        """
        rig_json, truth_json = out / "capture" / "rig.json", out / "capture" / "ground_truth.json"
        made = rig_json.exists() and truth_json.exists()
        if not made or read_run_json(truth_json)["config"] != asdict(DEMO_CAPTURE):
            synth(out / "capture", DEMO_CAPTURE)  # only then: new files would have the run start over
        run(out / "capture", out / "run", DEMO_RUN)
        truth = read_run_json(truth_json)["sfm_per_metre"]
        found = read_run_json(out / "run" / "scale.json")["sfm_per_metre"]
        error = 100 * abs(found / truth - 1)
        Terminal().say(f"true scale {truth:.5g}, found {found:.5g} SfM units per metre: off by {error:.3f} %")

    def experiment() -> None:
        """Tables beside rival methods: `rtgs experiment synthetic --out DIR`, ..."""
        raise AssertionError("`main` takes bench's own commands from `_experiments`")

    return {
        "run": run,
        "sfm": sfm,
        "rgb": rgb,
        "scale": scale,
        "thermal": thermal,
        "eval": eval_,
        "render": render,
        "export": export_,
        "import": import_,
        "synth": synth,
        "demo": demo,
        "experiment": experiment,
    }


def _experiments() -> dict[str, Callable[..., Any]]:
    """What stands behind `rtgs experiment`."""

    def synthetic(out: Path, config: Annotated[SyntheticExperimentConfig, Flat] = _EXPERIMENT_SYNTHETIC) -> None:
        """How well the scale is found on synthetic scenes, by this method and by its rivals.

        What an earlier call with the same settings has left in the folder is kept. To have one method done again, remove its records:
        DIR/records/*.ours.json.

        Args:
            out: folder for scenes, records, tables and figures.
            config: settings.
        """
        from rtgs.experiments.synthetic import synthetic_experiment

        reporter = Terminal()
        with reporter.stage("experiment synthetic") as progress:
            files = synthetic_experiment(out, config, progress=progress)
        for path in files:
            reporter.say(f"wrote {path}")

    def real(source: Folder, out: Path, config: Annotated[RealExperimentConfig, Flat] = _EXPERIMENT_REAL) -> None:
        """What a scale does to temperatures: thermal models at scales found in several ways, scored on held-out views of one capture.

        Rows that stand from an earlier call with the same inputs are not made again. A row that cannot run is listed with the reason.

        Args:
            source: a run folder, or a capture, which is run first (to OUT/run).
            out: folder for the tables and pictures.
            config: settings.
        """
        from rtgs.experiments.real import real_experiment

        reporter = Terminal()
        for path in real_experiment(source, out, config, reporter):
            reporter.say(f"wrote {path}")

    return {"synthetic": synthetic, "real": real}


def _opened(run: Path, reporter: Terminal) -> Pipeline:
    """The pipeline of an existing run."""
    from rtgs.run.pipeline import Pipeline, RunFolder

    return Pipeline(RunFolder(run), reporter)


def _changed(run: Path, **settings: Any) -> Pipeline:
    """The pipeline of an existing run with some settings replaced, and written down."""
    from rtgs.run.pipeline import Pipeline, RunFolder

    return Pipeline.changed(RunFolder(run), Terminal(), **settings)


def _stage(pipeline: Pipeline, stage: Stage) -> None:
    pipeline.run(stage)
    _report(pipeline, pipeline.reporter)


def _report(pipeline: Pipeline, reporter: Any) -> None:
    from rtgs.run.report import write_report

    reporter.say(f"report: {write_report(pipeline.folder.path)}")


class Terminal:
    """A `Reporter` on a terminal: a bar with the time left while work goes on, a line when it is done."""

    def __init__(self) -> None:
        self.console = Console()

    def say(self, text: str) -> None:
        self.console.print(text, markup=False, emoji=False, highlight=False, soft_wrap=True)

    @contextmanager
    def stage(self, title: str) -> Iterator[Progress]:
        bar = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=16),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[text]}", style="dim", markup=False),
            console=self.console,
        )
        with bar:
            task = bar.add_task(title, total=None, text="")
            yield lambda done, total, text: bar.update(task, completed=done, total=total, text=text)
