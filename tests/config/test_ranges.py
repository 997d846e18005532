"""Every numeric setting has a range, which is checked and shown."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator
from typing import Any

import pytest
from tests.helpers.settings_out_of_range import CONFIGS, NEEDED, NUMERIC, outside, with_number

from rtgs.base.errors import RtgsError
from rtgs.base.events import nobody
from rtgs.cli import main
from rtgs.cli.table import all_commands, experiment_commands
from rtgs.config import ManualConfig, RgbConfig, RunConfig
from rtgs.config.ranges import Range, ranges_of


def test_there_are_settings() -> None:
    assert len(CONFIGS) == 15 and len(NUMERIC) > 50 and (RunConfig, "rgb_max_side") in NUMERIC


@pytest.mark.parametrize(("config", "name"), NUMERIC, ids=lambda v: getattr(v, "__name__", v))
def test_every_numeric_setting_has_a_range_and_keeps_it(config: type, name: str) -> None:
    allowed, hint = ranges_of(config)[name], typing.get_type_hints(config)[name]
    needed = NEEDED.get(config, {})
    for second, part in ((False, allowed), (True, allowed.then)):
        for value in outside(part) if part else ():
            with pytest.raises(RtgsError, match=rf"{name} is .*; it is "):
                config(**{**needed, name: with_number(hint, value, second)})
    config(**needed)  # the defaults are in their ranges


def test_limits_themselves() -> None:
    assert Range(1, 3).holds(1) and Range(1, 3).holds(3) and not Range(1, 3).holds(4)
    assert not Range(above=0).holds(0) and Range(above=0).holds(1e-300) and not Range(0, below=1).holds(1)
    assert str(Range(0, 1, then=Range(1, 64))) == "at least 0 and at most 1, then at least 1 and at most 64"
    assert str(Range()) == "any finite number"
    with pytest.raises(RtgsError, match=r"manual\.metres is -1\.0; it is above 0"):
        ManualConfig(("a", "b"), -1.0)


@pytest.mark.parametrize("arguments", [["run"], ["synth"], ["experiment", "synthetic"], ["experiment", "real"]])
def test_help_shows_every_range(
    arguments: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    commands = {**all_commands(RunConfig(), nobody), **experiment_commands(nobody)}
    with pytest.raises(SystemExit) as stop:
        main([*arguments, "--help"])
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert stop.value.code in (0, None)

    def shown(config: Any) -> Iterator[str]:
        for allowed in ranges_of(config.__class__).values():
            yield str(allowed)
        for field in dataclasses.fields(config):
            if dataclasses.is_dataclass(getattr(config, field.name)):
                yield from shown(getattr(config, field.name))

    function: Any = commands[arguments[-1]]
    keywords = {**getattr(function.func, "keywords", {}), **function.keywords}
    expected = sorted(shown(keywords["config"]))
    assert expected
    for allowed in set(expected):
        assert text.count(f"; {allowed})") >= expected.count(allowed), allowed


def test_the_command_line_refuses_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    for flag, value in (("--rgb.sh-degree", "9"), ("--rgb.ssim-weight", "nan"), ("--scale.max-frames", "0")):
        with pytest.raises(SystemExit) as stop:
            main(["run", "capture", "--out", "run", flag, value])
        error = capsys.readouterr().err
        assert stop.value.code == 2 and value in error and error.startswith("error: ") and error.count("\n") == 1
    with pytest.raises(RtgsError, match=r"rgb\.steps is 9{60}; it is"):
        RgbConfig(steps=int("9" * 400))
