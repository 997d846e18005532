"""The section of hot and cold spots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from tests.helpers.inspection_pages import SPOTS, write_spots
from tests.helpers.made_up_run import make_run, page_of, summary

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import write_json
from rtgs.records.spots import ReferenceTemperature, SpotList
from rtgs.run.report.spots import MOST_LISTED, MOST_PICTURES
from rtgs.run.report.values import position


def text_of(run: Path, spots: SpotList) -> str:
    write_spots(run / "spots", spots)
    return page_of(run).text.replace("\u00a0", " ")


def test_every_spot_is_a_row_with_its_numbers_and_a_picture(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    text = text_of(run, SPOTS)
    assert "2 spots are 3 °C or more & <off>" in text  # escaped: it came back as text
    row = "1 hot 46.0 °C ± 0.31; the model shows 41.0 °C +26.0 K +28.0 K 123 cm², Ø 12.5 cm 1.23, −2.00, 0.50 7 of 9"
    assert row in text and "ΔT to reference" in text and "The reference: 18.0 °C, as stated." in text
    assert "2 cold 13.0 °C −5.0 K −5.0 K 1.5 m², Ø 1.38 m 0.00, 3.00, −1.00 1 of 1" in text  # no standard error
    assert len(page_of(run).images) == 2


def test_without_a_reference_there_is_no_such_column(tmp_path: Path) -> None:
    text = text_of(make_run(tmp_path / "run"), replace(SPOTS, reference=None))
    assert "+26.0 K 123 cm²" in text and "ΔT to reference" not in text and "as stated" not in text


def test_a_measured_reference_is_named_with_its_error(tmp_path: Path) -> None:
    wall = ReferenceTemperature("<wall>", 20.0, 0.05, 8)
    text = text_of(make_run(tmp_path / "run"), replace(SPOTS, reference=wall))
    assert "ΔT to <wall>" in text and "<wall>: 20.00 °C ± 0.05, as the model shows it; 8 photographs see it" in text


def test_without_metres_lengths_are_in_sfm_units(tmp_path: Path) -> None:
    text = text_of(make_run(tmp_path / "run"), replace(SPOTS, length_unit="SfM units"))
    assert "Ø 0.125 SfM units" in text and "cm" not in text.split("Hot and cold spots")[1].split("Metrics")[0]


def test_a_long_list_is_shown_in_part(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    text = text_of(run, replace(SPOTS, spots=SPOTS.spots * 12))
    assert f"24 spots are 3 °C or more & <off>. The strongest {MOST_LISTED} are shown." in text
    assert text.count("7 of 9") == 10 and len(page_of(run).images) == MOST_PICTURES


def test_no_spot_and_no_list_are_told_apart(tmp_path: Path) -> None:
    assert "No spot is 3 °C or more" in text_of(make_run(tmp_path / "empty"), replace(SPOTS, spots=()))
    run = make_run(tmp_path / "absent")
    assert "no list of hot and cold spots yet" in page_of(run).text
    write_json(run / "capture_summary.json", replace(summary(), unit="counts"))
    assert "--excess COUNTS" in page_of(run).text


def test_a_damaged_list_or_picture_is_named(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    folder = write_spots(run / "spots")
    (folder / "spots" / "001.png").write_bytes(b"no picture")
    with pytest.raises(RtgsError, match=r"001\.png: .*`rtgs spots` draws it again"):
        page_of(run)
    (folder / "spots.json").write_text("[]")
    with pytest.raises(RtgsError, match=r"spots\.json"):
        page_of(run)


def test_a_position_has_no_negative_zero() -> None:
    assert position((0.614, -0.001, -2.0)) == "0.61, 0.00, −2.00"
