"""The command line's manners: help, version, exit codes, one-line errors."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from rtgs import __version__
from rtgs.base.events import Event, ResultLine, WarningLine, WorkStarted, long_work, nobody
from rtgs.cli import main
from rtgs.cli.commands.demo import demonstrate
from rtgs.cli.options import saved_settings
from rtgs.cli.table import all_commands, calibrate_commands, experiment_commands
from rtgs.cli.terminal import Terminal
from rtgs.config import RunConfig, ScaleConfig, SynthConfig
from rtgs.run.config_file import SavedRun, write_config

ARGUMENTS = {
    "run": ["--out", "--rgb-max-side", "--rgb-ply", "--sfm.matching", "--rgb.steps", "--scale.init", "--thermal.steps"],
    "sfm": ["--out", "--max-features", "--matching", "--rgb-max-side"],
    "rgb": ["--steps", "--densify.max-gaussians", "--coarse-to-fine", "--rgb-ply"],
    "scale": ["--init", "--steps", "--learning-rate", "--scan-samples", "--level-weights"],
    "thermal": ["--steps", "--sh-degree", "--ssim-weight"],
    "eval": ["the run folder"],
    "doctor": ["folder with rgb/"],
    "render": ["--out", "--frames", "--viewpoint"],
    "spots": ["--out", "--excess", "--above", "--below", "--percentile", "--reference", "--fewest-views"],
    "report": ["--template", "--out", "--facts", "--write-facts", "--spots", "--pdf"],
    "view": ["--spots", "--host", "--port", "--no-browser"],
    "export": ["--out", "--format", "--frame", "--program", "--thermal-colours", "--plane", "--pixel-m"],
    "share": ["--out", "--title", "--no-spots", "--most-gaussians"],
    "info": ["file or folder"],
    "import": ["{flir,dji", "--out", "--rgb", "--rig"],
    "synth": ["--out", "--scene", "--frames", "--size", "--baseline-m", "--sfm-per-metre"],
    "demo": ["--out"],
    "calibrate": ["target"],
    "experiment": ["synthetic"],
}
CALIBRATIONS = {
    "target": ["PATH", "--out", "--inner-corners", "--square-m", "--board", "--marker-m", "--dictionary"],
    "from-run": ["the run folder", "--write"],
}
EXPERIMENTS = {
    "synthetic": ["--out", "--table", "--size", "--frames", "--scenes", "--seeds", "--rgb.quality", "--workers"],
    "real": ["PATH", "--out", "--manual.frames", "--depth-model", "--mast3r-weights", "--plane-m", "--region", "--thermal.drift"],
}


def code_of(arguments: list[str]) -> int:
    try:
        main(arguments)
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def errors(capsys: pytest.CaptureFixture[str]) -> str:
    """What stands on stderr: one line that says "error:", and no traceback."""
    text = capsys.readouterr().err
    assert text.startswith("error: ") and text.count("\n") == 1 and "Traceback" not in text
    return text


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], []])
def test_help_names_every_command(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert code_of(arguments) == 0
    text = capsys.readouterr().out
    for command in ARGUMENTS:
        assert f" {command} " in text, command


@pytest.mark.parametrize("command", ARGUMENTS)
def test_help_of_a_command_names_its_arguments(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert code_of([command, "--help"]) == 0
    text = capsys.readouterr().out
    for argument in ARGUMENTS[command]:
        assert argument in text, argument
    assert "(required)" in text or command in ("demo", "calibrate", "experiment")
    assert "--config" not in text  # settings are flags without a prefix


@pytest.mark.parametrize(
    ("group", "command", "arguments"),
    [
        *(("calibrate", command, arguments) for command, arguments in CALIBRATIONS.items()),
        *(("experiment", command, arguments) for command, arguments in EXPERIMENTS.items()),
    ],
)
def test_help_of_a_command_in_a_group_names_its_arguments(
    group: str, command: str, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert code_of([group, command, "--help"]) == 0
    text = capsys.readouterr().out
    for argument in arguments:
        assert argument in text, argument
    assert "(required)" in text and f"rtgs {group} {command}" in text


def test_commands_are_those_tested() -> None:
    assert set(all_commands(RunConfig(), nobody)) == set(ARGUMENTS)
    assert set(calibrate_commands(nobody)) == set(CALIBRATIONS)
    assert set(experiment_commands(nobody)) == set(EXPERIMENTS)


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert code_of(["--version"]) == 0
    assert capsys.readouterr().out == f"rtgs {__version__}\n"


HEAVY = ("torch", "numpy", "numba", "cv2", "pycolmap", "scipy", "matplotlib")


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("arguments", "output"),
    [
        (["--help"], "thermal"),
        (["--version"], __version__),
        (["run", "--help"], "--rgb.steps"),
        (["experiment", "synthetic", "--help"], "--scenes"),
        (["experiment", "real", "--help"], "--plane-m"),
        (["scale", "RUN", "--help"], "0.0123"),  # of the run's own settings
        (["thermal", "RUN", "--steps", "many"], ""),
    ],
)
def test_what_needs_no_work_loads_nothing_heavy(arguments: list[str], output: str, tmp_path: Path) -> None:
    write_config(tmp_path, SavedRun(tmp_path, RunConfig(scale=ScaleConfig(learning_rate=0.0123))))
    code = (
        "import sys\nfrom rtgs.cli import main\n"
        "try:\n    main(sys.argv[1:])\nexcept SystemExit:\n    pass\n"
        f"print('loaded:', *(m for m in {HEAVY!r} if m in sys.modules))"
    )
    command = [sys.executable, "-c", code, *(str(tmp_path) if a == "RUN" else a for a in arguments)]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert output in text and text.splitlines()[-1].strip() == "loaded:"


def test_python_m_rtgs() -> None:
    run = subprocess.run([sys.executable, "-m", "rtgs", "--version"], capture_output=True, text=True)
    assert (run.returncode, run.stdout) == (0, f"rtgs {__version__}\n")


def test_the_installed_command() -> None:
    (command,) = (e for e in entry_points(group="console_scripts") if e.name == "rtgs")
    assert command.load() is main


@pytest.mark.parametrize(
    "arguments", [["splat"], ["run"], ["run", "capture"], ["scale", "run", "--steps", "many"], ["render", "run", "--magic"]]
)
def test_a_wrong_command_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert code_of(arguments) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_a_capture_that_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert code_of(["run", str(tmp_path / "missing"), "--out", str(tmp_path / "run")]) == 2
    assert "missing" in errors(capsys) and not (tmp_path / "run").exists()
    (tmp_path / "empty").mkdir()
    assert code_of(["sfm", str(tmp_path / "empty"), "--out", str(tmp_path / "run")]) == 2
    assert "rig.json" in errors(capsys)


@pytest.mark.parametrize("command", ["rgb", "scale", "thermal", "eval", "render", "spots", "export"])
def test_a_run_that_is_none(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["--out", str(tmp_path / "out")] if command in ("render", "spots", "export") else []
    assert code_of([command, str(tmp_path), *out]) == 2
    assert "not a run folder" in errors(capsys) and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["[bold]", "x[/y]", "a:warning:b", "[link=file]"])
def test_names_are_printed_as_they_are(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert code_of(["run", str(tmp_path / name), "--out", str(tmp_path / "run")]) == 2
    assert name in errors(capsys)
    terminal = Terminal()
    with long_work(terminal, "work", "work") as progress:
        progress(1, 2, name)
        terminal(ResultLine(f"{name} done"))
        terminal(WarningLine(f"{name} odd"))
    shown = capsys.readouterr().out
    assert f"{name} done" in shown and f"warning: {name} odd" in shown


def test_long_messages_stay_on_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    deep = "word " * 40
    assert code_of(["run", f"{tmp_path}/{deep}/{deep}/{deep}", "--out", str(tmp_path / "run")]) == 2
    assert errors(capsys).count("word") == 120


def test_what_the_system_refuses_is_no_traceback(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "capture").mkdir()
    (tmp_path / "file").touch()
    assert code_of(["run", str(tmp_path / "capture"), "--out", str(tmp_path / "file" / "run")]) == 2
    assert "file/run: Not a directory" in errors(capsys)


@pytest.mark.thorough
def test_synth_and_its_refusals(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--frames", "3", "--size", "16", "--supersampling", "1", "--no-thermal-clean", "--sfm-per-metre", "2"]
    assert code_of(["synth", "--out", str(tmp_path / "capture"), *arguments]) == 0
    assert "true scale 2 SfM units per metre" in capsys.readouterr().out
    assert (tmp_path / "capture" / "rig.json").is_file()
    assert code_of(["synth", "--out", str(tmp_path), *arguments]) == 2  # holds something else
    assert "capture" in errors(capsys)
    assert code_of(["synth", "--out", str(tmp_path / "b"), "--gain-jitter", "2"]) == 2
    assert "--gain-jitter" in errors(capsys)


def test_saved_settings_are_found_wherever_the_run_stands(tmp_path: Path) -> None:
    config = RunConfig(rgb_max_side=123)
    (tmp_path / "run").mkdir()
    write_config(tmp_path / "run", SavedRun(tmp_path / "capture", config))
    run = str(tmp_path / "run")
    for arguments in (
        ["run", "capture", "--out", run],
        ["run", "--out", run, "capture"],
        ["sfm", "capture", f"--out={run}", "--seed", "1"],
        ["scale", run, "--steps", "3"],
        ["scale", "--steps", "3", run],
        ["thermal", run],
        ["rgb", run],
    ):
        assert saved_settings(arguments) == config, arguments
    for arguments in (["run", "capture", "--out", str(tmp_path / "new")], ["run", run, "--out", "x"], ["scale"], []):
        assert saved_settings(arguments) == RunConfig(), arguments


def test_demo_keeps_its_capture(tmp_path: Path) -> None:
    """A second call goes on with the first one's run; a demo of other settings makes its own capture."""
    small = SynthConfig(frames=3, size=16, supersampling=1, thermal_clean=False)

    def stop_in_run(event: Event) -> None:
        if isinstance(event, WorkStarted) and event.name != "synth":
            raise KeyboardInterrupt

    image = tmp_path / "capture" / "rgb" / "frame_000.png"
    times = []
    for config in (small, small, replace(small, frames=4)):
        with pytest.raises(KeyboardInterrupt):
            demonstrate(tmp_path, config, RunConfig(), stop_in_run)
        times.append(image.stat().st_mtime_ns)
    assert times[0] == times[1] < times[2]
