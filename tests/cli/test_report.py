"""`rtgs report`: which file is written, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.helpers.inspection_pages import report_of, write_spots
from tests.helpers.made_up_run import make_run
from tests.helpers.tiny_run import recorded

from rtgs.base.events import WarningLine
from rtgs.run.inspection import read_facts


@pytest.mark.thorough
def test_both_templates_and_the_file_of_facts(tmp_path: Path) -> None:
    run, facts = make_run(tmp_path / "run"), tmp_path / "facts.json"
    spots = write_spots(tmp_path / "spots")
    assert recorded(["report", str(run)])[1] == 0 and (run / "report.html").is_file()
    assert not (run / "inspection.html").exists()
    inspection = ["report", str(run), "--template", "inspection"]
    assert recorded([*inspection, "--write-facts", str(facts)])[1] == 0
    assert not (run / "inspection.html").exists()
    read_facts(facts)
    facts.write_text(facts.read_text().replace('"client": ""', '"client": "Somebody"'), encoding="utf-8")
    recorder, code = recorded([*inspection, "--facts", str(facts), "--spots", str(spots)])
    assert code == 0 and any("inspection.html" in line for line in recorder.lines)
    page = report_of(run / "inspection.html")
    assert page.fields["Client"] == "Somebody" and len(page.rows) == 3


def test_what_belongs_to_the_other_template_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = make_run(tmp_path / "run")
    assert recorded(["report", str(run), "--pdf"])[1] == 2
    assert "--pdf: belongs to the inspection report" in capsys.readouterr().err
    assert recorded(["report", str(run), "--template", "inspection", "--facts", str(tmp_path / "absent.json")])[1] == 2
    assert "--write-facts" in capsys.readouterr().err and not (run / "inspection.html").exists()


def test_what_a_run_lacks_is_said_and_the_report_is_written(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    (run / "scale.json").unlink(missing_ok=True)
    recorder, code = recorded(["report", str(run)])
    assert code == 0 and (run / "report.html").is_file()
    warning = next(event.text for event in recorder.events if isinstance(event, WarningLine))
    assert "scale.json" in warning and "rtgs run" in warning and f"--out {run}" in warning
