"""Decisions of the stages, in words."""

from __future__ import annotations

from pathlib import Path

from tests.helpers.made_up_run import make_run, page_of

from rtgs.base.json_records import write_json
from rtgs.records.decision import Decision
from rtgs.records.radiometry import LinearRange
from rtgs.renderer import RenderSettings
from rtgs.run.model_files import RgbFile, ThermalFile

DECISIONS = [
    Decision("drift", "offset", "Offsets lower the error within validation frames.", 0.5, 0.41, "°C", 0.02),
    Decision("a <new> rule", "<none>", "The user chose it."),
    Decision("ridge", "0.01", "The smallest error of four.", error_after=40.04, unit="counts", threshold=0.0),
]


def thermal_file(*decisions: Decision) -> ThermalFile:
    span = LinearRange(18.0, 41.5)
    return ThermalFile([0.5], RenderSettings(), {}, span, span, 2.4, {}, decisions=decisions)


def test_every_decision_is_a_row_with_its_numbers(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    write_json(run / "thermal.json", thermal_file(*DECISIONS))
    page = page_of(run)
    assert page.headings[6:9] == ["Metrics", "Decisions", "Time taken"]
    drift = "Drift of the sensor offset Offsets lower the error within validation frames. 0.500 → 0.410 °C (−18.0 %) 2 %"
    assert drift in page.text
    assert "a <new> rule <none> The user chose it. not measured –" in page.text  # escaped, and nothing invented
    assert "Regularisation (ridge) 0.01 The smallest error of four. 40.0 counts 0 %" in page.text


def test_decisions_about_the_rgb_model_come_first(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    background = Decision("background", "#ffffff", "Least squares.", 30.0, 1.5, "% of white")
    write_json(run / "rgb.json", RgbFile([1.0, 1.0, 1.0], RenderSettings(), {}, (background,)))
    write_json(run / "thermal.json", thermal_file(DECISIONS[0]))
    text = page_of(run).text
    row = "Background of the imported RGB model #ffffff Least squares. 30.0 → 1.5 % of white (−95.0 %) –"
    assert row in text and text.index(row) < text.index("Drift of the sensor")


def test_a_model_without_decisions_has_no_such_section(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    write_json(run / "thermal.json", thermal_file())
    assert "Decisions" not in page_of(run).headings
