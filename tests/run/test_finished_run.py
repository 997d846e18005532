"""A finished run keeps its results whatever it is called with, and whichever version wrote its files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.helpers.settings_out_of_range import refused_flags
from tests.helpers.tiny_run import NOT_RESULTS, all_complete, recorded

pytestmark = pytest.mark.thorough


def hashes(run: Path, but: tuple[str, ...] = NOT_RESULTS) -> dict[str, str]:
    files = (p for p in run.rglob("*") if p.is_file() and p.name not in but)
    return {p.relative_to(run).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_every_numeric_setting_out_of_its_range(capture: Path, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of each setting the last number that is not allowed; `tests/config` has the others."""
    before = hashes(run, ())
    flags = {given[0]: given for given in refused_flags()}
    assert len(flags) > 30 and {"--rgb-max-side", "--rgb.densify.every", "--scale.init", "--thermal.steps"} <= set(flags)
    for given in flags.values():
        assert recorded(["run", str(capture), "--out", str(run), *given])[1] == 2, given
        errors = capsys.readouterr().err
        assert "Traceback" not in errors and errors, given
        assert hashes(run, ()) == before, given
    assert all_complete(run)


CHANGES: dict[str, Callable[[dict[str, Any]], Any]] = {
    "a newer version's field": lambda data: {**data, "colour_of_the_sky": 1},
    "an older version's lack of one": lambda data: dict(list(data.items())[1:]),
    "another type": lambda data: {name: [value] for name, value in data.items()},
    "a list": lambda data: [data],
    "half of the file": lambda data: None,
}
EXPORTED = ("config.json", "scale.json", "rgb.json", "thermal.json", "scene/failures.json")
OTHERS = ("stages.json", "metrics.json", "capture_summary.json")


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("name", [*EXPORTED, *OTHERS])
def test_files_of_another_version(
    capture: Path, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, change: str
) -> None:
    """A command that reads the file refuses it, and no result is changed."""
    path = run / name
    text = path.read_text(encoding="utf-8")
    changed = CHANGES[change](json.loads(text))
    path.write_text(text[: len(text) // 2 - 1] if changed is None else json.dumps(changed), encoding="utf-8")
    before = hashes(run, ("report.html", "hashes.json"))
    for arguments in (["export", str(run), "--out", str(tmp_path / "export")], ["run", str(capture), "--out", str(run)]):
        code, errors = recorded(arguments)[1], capsys.readouterr().err
        assert "Traceback" not in errors and code in (0, 2), (arguments, errors)
        reads_it = name in EXPORTED or arguments[0] == "run"
        if reads_it and change in ("another type", "a list", "half of the file") and name != "scene/failures.json":
            assert code == 2 and name in errors, (arguments, errors)
        if code == 2:
            assert hashes(run, ("report.html", "hashes.json")) == before, arguments
