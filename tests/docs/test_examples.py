"""The numbered examples and the README's Python example run as they are."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

import pytest

from rtgs.synthetic import SynthConfig, write_capture

pytestmark = pytest.mark.thorough

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("[0-9][0-9]_*.py"))
PRINTED = {
    "01_whole_run": r"status ok\nheld-out thermal views: \d+\.\d dB, off by \d\.\d\d °C",
    "02_scale_and_interval": r"status: ok[^\n]*\nsearched [^\n]+ found 15\.[345]\d* SfM units per metre\n95 % interval",
    "03_temperature_along_a_line": r"middle of the view: \d+\.\d °C at \d\.\d\d m\nx -0\.\d+ m, depth",
    "04_new_viewpoint": r"new_view\.rgb\.png and new_view\.thermal\.png: -?\d+\.\d to \d+\.\d °C",
    "05_model_in_metres": r"200 Gaussians of 3 channels\nwrote metres\.ply: 0\.\d+ × 0\.\d+ × 0\.\d+ m",
    "06_your_own_camera": r"5 pairs, baseline 0\.05 m, up to 30\.0 °C",
}


def run(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `python path` would, in this process."""
    monkeypatch.syspath_prepend(str(path.parent))
    monkeypatch.setattr(sys, "argv", [str(path)])
    runpy.run_path(str(path), run_name="__main__")


def test_there_is_an_expectation_for_each() -> None:
    assert [p.stem for p in EXAMPLES] == sorted(PRINTED)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_an_example_runs_alone(path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    run(path, monkeypatch)
    assert re.search(PRINTED[path.stem], capsys.readouterr().out)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_an_example_is_short_and_says_how_to_call_it(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 40
    assert f"python examples/{path.name}" in text.split('"""')[1]
    assert path.name in (ROOT / "docs" / "how-to" / "python.md").read_text(encoding="utf-8")


def test_the_example_of_the_readme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    truth = write_capture(tmp_path / "rtgs-demo" / "capture", SynthConfig(frames=16, size=64, thermal_clean=False))
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(code, names)
    assert getattr(names["scale"], "sfm_per_metre") == pytest.approx(truth.sfm_per_metre, rel=0.1)  # noqa: B009
    assert "ok" in capsys.readouterr().out
