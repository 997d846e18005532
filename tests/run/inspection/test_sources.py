"""What the files say: object parameters, tags of the photographs, the place on the Earth, and what `rtgs doctor` finds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.helpers.corner_run import corner, spot_list
from tests.helpers.inspection_pages import Report, write_spots
from tests.helpers.made_up_run import make_run
from tests.helpers.radiometric_files import RADIOMETRY

from rtgs.doctor import Diagnosis, Finding
from rtgs.run.inspection.facts import CameraFacts, InspectionFacts
from rtgs.run.inspection.inspection import Inspection
from rtgs.run.inspection.metres import accuracy_section, warnings_section
from rtgs.run.inspection.order import camera_section, order_section
from rtgs.run.inspection.words import Words
from rtgs.run.report.run_records import RunRecords


def photograph(path: Path, taken: str) -> None:
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0132] = "FLIR", "T1020 <x>", taken
    path.parent.mkdir(exist_ok=True)
    Image.new("RGB", (8, 8)).save(path, exif=exif)


@pytest.fixture
def report(tmp_path: Path) -> Inspection:
    """A run of a radiometric capture, with tags in its RGB photographs."""
    made = corner()
    capture = replace(made.subject.scene.capture, radiometry=RADIOMETRY)
    subject = replace(made.subject, scene=replace(made.subject.scene, capture=capture))
    photograph(tmp_path / "rgb" / "a.jpg", "2026:05:01 10:20:30")
    photograph(tmp_path / "rgb" / "b.jpg", "2026:05:01 11:00:00")
    (tmp_path / "thermal").mkdir()
    Image.fromarray(np.zeros((4, 4), np.uint16)).save(tmp_path / "thermal" / "a.tiff")
    spots = write_spots(tmp_path / "spots", spot_list(made))
    records = replace(RunRecords.read(make_run(tmp_path / "run")), capture=tmp_path)
    return Inspection(records, InspectionFacts(), True, Words.load(), spots, spot_list(made), subject)


def test_what_the_user_leaves_out_is_taken_from_the_files(report: Inspection) -> None:
    used = RADIOMETRY.parameters
    page = Report(camera_section(report))
    assert page.fields["Emissivity"] == f"{used.emissivity:g} (from the files)"
    assert page.fields["Reflected apparent temperature"].replace("−", "-") == f"{used.reflected_c:g} °C (from the files)"
    assert page.fields["Distance to the object"] == f"{used.distance_m:g} m (from the files)"
    assert page.fields["Thermal camera"] == "FLIR T1020 <x> (from the files)"
    assert "Serial number" in page.empty
    date = Report(order_section(report)).fields["Date"]
    assert date == "2026-05-01 10:20:30 – 2026-05-01 11:00:00 (from the files)"


def test_what_the_user_states_stands_and_a_difference_is_said(report: Inspection) -> None:
    used = RADIOMETRY.parameters
    stated = CameraFacts(model="Another", emissivity=0.5, reflected_c=used.reflected_c)
    report = replace(report, facts=InspectionFacts(camera=stated))
    for section in (camera_section, warnings_section):
        text = Report(section(report)).text
        assert f"Emissivity: 0.5 is stated, but the temperatures were computed with {used.emissivity:g}" in text
        assert "Reflected apparent temperature: " not in text  # stated as it was used
    page = Report(camera_section(report))
    assert page.fields["Thermal camera"] == "Another" and page.fields["Emissivity"] == "0.5"


def test_without_object_parameters_nothing_is_taken_for_them(report: Inspection) -> None:
    page = Report(camera_section(replace(report, subject=None)))
    assert {"Emissivity", "Thermal camera", "Distance to the object"} <= set(page.empty)
    assert page.fields["Camera of the RGB photographs"] == "FLIR T1020 <x> (from the files)"


def test_errors_and_warnings_of_the_examination_are_shown_and_notes_are_not(report: Inspection) -> None:
    findings = tuple(Finding("<blur>", level, f"a {level}.", "Hold still.") for level in ("error", "warning", "note"))
    text = Report(warnings_section(replace(report, diagnosis=Diagnosis(Path("capture"), findings)))).text
    assert "Capture, <blur>: a error. Hold still." in text and "a warning. Hold still." in text and "a note" not in text


def test_the_emissivity_that_temperatures_rest_on_is_said(report: Inspection) -> None:
    text = Report(accuracy_section(report)).text
    assert f"computed with an emissivity of {RADIOMETRY.parameters.emissivity:g}." in text
    stated = InspectionFacts(camera=CameraFacts(emissivity=0.5))
    assert (
        "The files do not say with which emissivity" in Report(accuracy_section(replace(report, subject=None, facts=stated))).text
    )
