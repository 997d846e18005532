"""Decisions of the thermal fit, in words."""

from __future__ import annotations

from pathlib import Path

from tests.helpers.made_up_run import make_run, page_of

from rtgs.base.json_records import write_json
from rtgs.records.decision import Decision

DECISIONS = [
    Decision("sensor drift", "offset", "One offset a frame predicts the frames set aside better.", 0.5, 0.41, "°C", 0.02),
    Decision("sensor pattern", "<none>", "The user chose it."),
    Decision("ridge", "0.01", "The smallest error of four.", error_after=0.4004, unit="counts", threshold=0.0),
]


def test_every_decision_is_a_row_with_its_numbers(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    write_json(run / "thermal.json", {"background": [0.5], "decisions": DECISIONS})
    page = page_of(run)
    assert page.headings[5:8] == ["Metrics", "What the thermal fit decided", "Time taken"]
    drift = "sensor drift offset One offset a frame predicts the frames set aside better. 0.5 → 0.41 °C (−18.0 %) 2 %"
    assert drift in page.text
    assert "sensor pattern <none> The user chose it. not measured –" in page.text  # escaped, and nothing invented
    assert "ridge 0.01 The smallest error of four. 0.4 counts 0 %" in page.text


def test_a_model_without_decisions_has_no_such_section(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    for content in ({"background": [0.5]}, {"decisions": []}):
        write_json(run / "thermal.json", content)
        assert "What the thermal fit decided" not in page_of(run).headings
