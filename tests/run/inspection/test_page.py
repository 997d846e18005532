"""The inspection report of a made-up run: values are the records', text is escaped, what is missing is said, nothing is fetched."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest
from tests.helpers.inspection_pages import SPOTS, Report, report_of, write_spots
from tests.helpers.made_up_run import estimate, evaluation, make_run, summary

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import write_json
from rtgs.metres.combine import combine
from rtgs.records.metres import MetresSource
from rtgs.records.spots import SpotList
from rtgs.run.folder import RunFolder
from rtgs.run.inspection import InspectionFacts, write_inspection
from rtgs.run.inspection.facts import CameraFacts, OrderFacts, SeverityClass, WeatherFacts

FACTS = InspectionFacts(
    order=OrderFacts(client="<script>alert(1)</script> & Sons", site='Hall "7"'),
    camera=CameraFacts(model="T1020", calibrated="2026-01-15", emissivity=0.95, accuracy="±2 °C <or> 2 %"),
    weather=WeatherFacts(outdoor_c=-3.5, wind_m_s=0.0),
    reference="air & room",
    severity=(SeverityClass("<B>", 20, "repair"), SeverityClass("A", 5, "watch")),
    remarks="first\n<i>second</i>",
)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    run = make_run(tmp_path / "run")
    write_spots(run / "spots")
    return run


def written(run: Path, facts: InspectionFacts | None = FACTS, spots: Path | None = None) -> Report:
    return report_of(write_inspection(run, run.parent / "out" / "inspection.html", facts=facts, spots=spots))


def test_findings_are_those_of_the_list(run: Path) -> None:
    first, second = written(run).rows[-2:]
    assert first == {
        "No.": "1",
        "Kind": "hot",
        "Class": "<B>",
        "Temperature": "46.0 °C ± 0.31",
        "Surroundings": "20.0 °C",
        "ΔT to surroundings": "+26.0 K",
        "ΔT to reference": "+28.0 K",
        "Extent": "123 cm², Ø 12.5 cm",
        "Position x, y, z (m)": "1.23, −2.00, 0.50",
        "Photographs": "7 of 9",
    }
    assert second["Class"] == "A" and second["Temperature"] == "13.0 °C" and second["ΔT to surroundings"] == "−5.0 K"
    assert second["Extent"] == "1.5 m², Ø 1.38 m" and second["ΔT to reference"] == "−5.0 K"


def test_what_the_user_states_is_text(run: Path) -> None:
    page = written(run)
    assert page.fields["Client"] == "<script>alert(1)</script> & Sons"  # escaped: it came back as text
    assert page.fields["Outdoor air"] == "−3.5 °C" and page.fields["Wind"] == "0 m/s" and page.fields["Emissivity"] == "0.95"
    assert not page.tags & {"script", "i", "iframe", "link", "form"}
    for words in ('Hall "7"', "<i>second</i>", "±2 °C <or> 2 %, as stated", "air & room", "3 °C or more & <off>", "<b>7"):
        assert words in page.text, words


def test_empty_fields_are_marked(run: Path) -> None:
    page = written(run)
    assert {"Operator", "Serial number", "Clouds", "Reflected apparent temperature", "Distance to the object"} <= set(page.empty)
    assert not {"Client", "Wind", "Thermal camera"} & set(page.empty)
    nothing = written(run, None)
    assert {"Client", "Wind", "Thermal camera"} <= set(nothing.empty) and "--write-facts" in nothing.text


def test_nothing_is_fetched(run: Path) -> None:
    path = write_inspection(run, run / "inspection.html", facts=FACTS)
    page, source = report_of(path), path.read_text(encoding="utf-8")
    assert len(page.images) == 2  # a picture for each finding
    assert all(link.startswith(("data:image/", "#")) for link in page.links), page.links
    assert "default-src 'none'" in source and "url(http" not in source and "@import" not in source


def test_accuracy_and_lengths_are_those_of_the_records(run: Path) -> None:
    text = written(run).text
    assert "differ from the photographs by 0.580 °C on average" in text and "On 9 thermal photographs" in text
    assert "0.31 °C to 0.31 °C" in text and "Findings 2 have no standard error" in text
    assert "Findings 1: the 3D model shows another temperature" in text
    assert "One metre is 2.4312 units" in text and "2.402 to 2.461" in text and "−1.2 % to +1.2 %" in text
    assert "distance between the two cameras of the rig, 20 cm" in text
    assert "frame_0014 was not used: blurred <motion>" in text and "Rig.json and the poses disagree" in text


def test_peak_errors_are_shown_where_they_are_known(run: Path) -> None:
    scored = replace(evaluation(), thermal=replace(evaluation().thermal, peak_c=1.234, peak_p90_c=2.5))
    scored.write(run / "metrics.json")
    text = written(run).text
    assert "1.23 °C on average" in text and "below 2.50 °C" in text


def test_without_a_table_there_are_no_classes(run: Path) -> None:
    page = written(run, replace(FACTS, severity=()))
    assert "Class" not in page.rows[-1] and "findings have no class" in page.text


def test_classes_may_refer_to_the_reference(run: Path) -> None:
    facts = replace(FACTS, severity_of="reference", severity=(SeverityClass("A", 5.1, ""), SeverityClass("B", 28, "")))
    assert [row["Class"] for row in written(run, facts).rows[-2:]] == ["B", "below all classes"]
    spots = write_spots(run.parent / "other", replace(SPOTS, reference=None))
    page = written(run, facts, spots)
    assert "Class" not in page.rows[-1] and "the list has none" in page.text and "No reference was stated" in page.text


def test_a_run_without_spots_says_so(tmp_path: Path) -> None:
    page = written(make_run(tmp_path / "run"))
    assert "no list of hot and cold spots" in page.text and "rtgs spots" in page.text and not page.images
    assert "Each finding" not in page.headings and "Findings" in page.headings


def test_an_empty_list_is_another_thing(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    write_spots(run / "spots", SpotList((), "°C", "3 °C or more"))
    assert "The list of hot and cold spots is empty. Criterion: 3 °C or more." in written(run).text


@pytest.mark.parametrize("name", ["scale", "metrics", "config", "capture_summary"])
def test_a_missing_record_is_named(run: Path, name: str) -> None:
    (run / f"{name}.json").unlink()
    text = written(run).text
    assert {"scale": "Missing: scale.json", "metrics": "To do so: rtgs run"}.get(name, "No plan:") in text
    assert "None" not in text and "nan" not in text.lower().split()


def test_a_missing_capture_and_a_missing_picture_are_named(run: Path) -> None:
    (run / "spots" / "spots" / "002.png").unlink()
    page = written(run)
    assert "No plan:" in page.text and "No rendered picture:" in page.text and "Put it back" in page.text
    assert "Missing: the picture" in page.text and "002.png" in page.text


def test_a_list_that_is_older_than_the_model_is_said(run: Path) -> None:
    assert "older than the model" not in written(run).text
    later = (run / "spots" / "spots.json").stat().st_mtime + 10
    os.utime(run / "scale.json", (later, later))
    assert "older than the model" in written(run).text


def test_what_cannot_be_used_is_refused(run: Path) -> None:
    out = run / "inspection.html"
    with pytest.raises(RtgsError, match="no such run folder"):
        write_inspection(run / "absent", out)
    with pytest.raises(RtgsError, match=r"has no spots\.json"):
        write_inspection(run, out, spots=run)
    with pytest.raises(RtgsError, match=r"ends in \.html"):
        write_inspection(run, run / "inspection.txt")
    (run / "spots" / "spots.json").write_text("[", encoding="utf-8")
    with pytest.raises(RtgsError, match=r"spots\.json"):
        write_inspection(run, out)
    assert not out.exists()


def test_lengths_in_doubt_come_without_an_accuracy(run: Path) -> None:
    doubtful = replace(estimate(), status="unobservable", reason="flow is under half a pixel <x>", ci95=None, std_log=None)
    RunFolder(run).write_scale(doubtful)
    text = written(run).text
    assert "Do not rely on lengths: flow is under half a pixel <x>" in text and "Lengths: flow is under" in text
    assert "no accuracy of lengths may be claimed" in text and "95 % interval" not in text


def test_lengths_rest_on_the_sources_that_count(run: Path) -> None:
    sources = [MetresSource("baseline", 2.4312, 0.006, "edges"), MetresSource("gps", 2.44, 0.01, "RTK of 40 <photographs>")]
    found = combine(sources, {"board": "no image shows it"})
    RunFolder(run).write_scale(replace(estimate(), metres=found))
    text = written(run).text
    assert found.sfm_per_metre is not None and found.ci95 is not None
    assert f"One metre is {found.sfm_per_metre:.5g} units" in text
    assert f"95 % interval: {found.ci95[0]:.5g} to {found.ci95[1]:.5g}" in text
    assert "Metres rest on: Baseline, GPS." in text and "GPS: RTK of 40 <photographs>." in text
    assert "Board gives nothing: no image shows it." in text


def test_counts_are_no_temperatures(run: Path) -> None:
    write_json(run / "capture_summary.json", replace(summary(), unit="counts"))
    spots = write_spots(run.parent / "counts", replace(SPOTS, unit="counts"))
    page = written(run, spots=spots)
    assert page.rows[-2]["Temperature"] == "46.0 counts ± 0.31" and page.rows[-2]["ΔT to surroundings"] == "+26.0 counts"
    assert "no temperature may be claimed" in page.text and "on average" not in page.text


def test_a_length_is_longest_where_a_metre_is_fewest_units(run: Path) -> None:
    RunFolder(run).write_scale(replace(estimate(), ci95=(2.2, 2.6)))
    assert "uncertain by −6.5 % to +11 %" in written(run).text
