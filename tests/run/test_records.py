"""The facts of a capture on disk."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.helpers.made_up_run import summary

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import write_json
from rtgs.run.records import CaptureSummary


def test_what_is_written_is_read(tmp_path: Path) -> None:
    write_json(tmp_path / "summary.json", summary())
    assert CaptureSummary.read(tmp_path / "summary.json") == CaptureSummary(
        **{**vars(summary()), "warnings": list(summary().warnings)}
    )


@pytest.mark.parametrize(("earlier", "unit"), [("celsius", "°C"), ("relative", "counts")])
def test_runs_of_0_1_0_are_read(tmp_path: Path, earlier: str, unit: str) -> None:
    write_json(tmp_path / "summary.json", summary())
    data = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    del data["unit"]
    write_json(tmp_path / "summary.json", {**data, "thermal_unit": earlier})
    assert CaptureSummary.read(tmp_path / "summary.json").unit == unit


def test_an_unknown_unit_is_refused(tmp_path: Path) -> None:
    write_json(tmp_path / "summary.json", {**vars(summary()), "unit": "kelvin"})
    with pytest.raises(RtgsError, match=r"summary.json: field 'unit' .*'kelvin'.* Remove it and run again"):
        CaptureSummary.read(tmp_path / "summary.json")
