"""Flags of every command, the overview, and what is printed where there is no terminal."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from rtgs.base.events import ResultLine, WarningLine, long_work, nobody
from rtgs.cli import main
from rtgs.cli.manners import Manners, taken_out
from rtgs.cli.overview import EXAMPLES, GROUPS
from rtgs.cli.table import all_commands
from rtgs.cli.terminal import Terminal
from rtgs.config import RunConfig


def ended(arguments: list[str]) -> int:
    try:
        main(arguments)
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def test_flags_are_taken_out_wherever_they_stand() -> None:
    assert taken_out(["--quiet", "run", "a", "--json"]) == (Manners(quiet=True, json=True), ["run", "a"])
    assert taken_out(["info", "--", "--debug"]) == (Manners(), ["info", "--", "--debug"])


def test_the_overview_groups_every_command_and_its_examples_name_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert ended(["--help"]) == 0
    text, commands = capsys.readouterr().out, all_commands(RunConfig(), nobody)
    assert {name for names in GROUPS.values() for name in names} == set(commands) and "Others" not in text
    for title in GROUPS:
        assert f"\n{title}:\n" in text
    assert {example.split()[1] for example, _ in EXAMPLES} <= set(commands)


def told(manners: Manners, capsys: pytest.CaptureFixture[str]) -> str:
    terminal = Terminal(manners)
    with long_work(terminal, "scale", "metric scale") as progress:
        progress(1, 2, "half")
    terminal(ResultLine("scale: 2"))
    terminal(WarningLine("odd"))
    return capsys.readouterr().out


def test_without_a_terminal_there_are_no_bars_and_no_colours(capsys: pytest.CaptureFixture[str]) -> None:
    assert told(Manners(), capsys) == "metric scale: 0:00 taken\nscale: 2\nwarning: odd\n"


def test_quiet_leaves_warnings(capsys: pytest.CaptureFixture[str]) -> None:
    assert told(Manners(quiet=True), capsys) == "warning: odd\n"


def test_json_is_an_object_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    found = [json.loads(line) for line in told(Manners(json=True), capsys).splitlines()]
    assert found[0]["work"] == "scale" and found[0]["completed"] and found[1:] == [{"result": "scale: 2"}, {"warning": "odd"}]


def test_debug_shows_where_an_error_comes_from(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["info", str(tmp_path / "missing")]
    assert ended(arguments) == 2
    plain = capsys.readouterr().err
    assert plain.count("\n") == 1 and "no such file" in plain
    assert ended([*arguments, "--debug"]) == 2
    shown = capsys.readouterr().err
    assert "Traceback" in shown and "info.py" in shown and shown.endswith(plain)


def test_a_defect_is_a_line_too(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("[1, 2]")
    monkeypatch.setattr("rtgs.run.info.lines", lambda facts: [][1])
    assert ended(["info", str(tmp_path / "a.json")]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "IndexError" in error and "--debug" in error


@pytest.mark.thorough
def test_completion_is_printed() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "rtgs", "--tyro-print-completion", "bash"], capture_output=True, text=True, check=True
    )
    assert "complete" in done.stdout and "thermal" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["spots", "RUN", "--out", "O", "--percentile", "200"], "--percentile is 200.0"),
        (["run", "CAPTURE", "--out", "O", "--scale.steps=0"], "--scale.steps is 0"),
        (["rgb", "RUN", "--densify.every", "0"], "--densify.every is 0"),
    ],
)
def test_a_number_out_of_range_is_named_as_it_was_typed(
    arguments: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended(arguments) == 2
    assert f"error: {named}; it is at least" in capsys.readouterr().err
