"""`spots.csv` and `spots.json`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from rtgs.base.json_records import read_record, write_json
from rtgs.records.spots import ReferenceTemperature, Spot, SpotList
from rtgs.run.spots import COLUMNS, reference_line, row_of, spot_line

SPOT = Spot("cold", (1.0, -2.0, 0.5), 0.01, 12.0, 13.0, 20.0, 0.1, 7, 9, ("f3", "f1"), 9.0, 0.2)
WALL = ReferenceTemperature("wall", 18.0, 0.05, 8)
LISTED = SpotList((SPOT,), "°C", "3 °C or more")


def test_a_spot_is_read_as_it_was_written(tmp_path: Path) -> None:
    spots = SpotList((SPOT, replace(SPOT, std=None, modelled_std=None)), "°C", "3 °C or more", WALL)
    write_json(tmp_path / "spots.json", spots)
    assert read_record(SpotList, tmp_path / "spots.json") == spots
    data = json.loads((tmp_path / "spots.json").read_text(encoding="utf-8"))["spots"][0]
    assert data["excess"] == -8.0 and data["model_differs"] is True and data["diameter_m"] == pytest.approx(0.1128, abs=1e-4)


def test_model_and_photographs_differ_beyond_two_standard_errors() -> None:
    assert SPOT.model_differs and not replace(SPOT, modelled=11.7).model_differs
    assert not replace(SPOT, std=None).model_differs
    assert "the model shows 9.0 °C" in spot_line(1, SPOT, LISTED)
    assert "model" not in spot_line(1, replace(SPOT, modelled=11.9), LISTED)


def test_a_row_has_a_cell_for_every_column() -> None:
    row = dict(zip(COLUMNS, row_of(3, SPOT, replace(LISTED, reference=WALL)), strict=True))
    assert (
        row["number"] == "3" and row["off_reference"] == "-6" and row["best_frames"] == "f3 f1" and row["model_differs"] == "yes"
    )
    assert dict(zip(COLUMNS, row_of(3, replace(SPOT, std=None), LISTED), strict=True))["std"] == ""


def test_the_reference_is_told_with_its_error() -> None:
    listed = replace(LISTED, reference=WALL)
    assert reference_line(listed) == "reference wall: 18.00 ± 0.05 °C, 8 views" and reference_line(LISTED) == ""
    assert reference_line(replace(LISTED, reference=ReferenceTemperature("", 21.0))) == "reference: 21.00 °C"
    assert "-6.0 to the reference" in spot_line(1, SPOT, listed) and "reference" not in spot_line(1, SPOT, LISTED)
    row = dict(zip(COLUMNS, row_of(1, SPOT, listed), strict=True))
    assert (row["reference_name"], row["reference"], row["reference_std"]) == ("wall", "18", "0.05")
