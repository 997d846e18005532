"""Marks and plan of a run whose truth is known: each number stands where its finding is."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.helpers.corner_run import GIVEN_FROM_UPRIGHT, SPOT_AT, Corner, corner, spot_list
from tests.helpers.inspection_pages import Report
from tests.helpers.made_up_run import make_run

from rtgs.run.inspection.facts import InspectionFacts
from rtgs.run.inspection.findings import position_of
from rtgs.run.inspection.inspection import Inspection
from rtgs.run.inspection.marks import marked_views, marks_section
from rtgs.run.inspection.plan import plan_section
from rtgs.run.inspection.words import Words
from rtgs.run.report.run_records import RunRecords


@pytest.fixture(scope="module")
def scene() -> Corner:
    return corner()


@pytest.fixture
def report(scene: Corner, tmp_path: Path) -> Inspection:
    records = RunRecords.read(make_run(tmp_path / "run"))
    return Inspection(records, InspectionFacts(), False, Words.load(), tmp_path, spot_list(scene), scene.subject)


def test_positions_are_metres_with_z_up(report: Inspection) -> None:
    assert report.spots is not None and report.subject is not None and report.frame is not None and report.frame.axes == "z-up"
    spot, scene = report.spots.spots[0], report.subject.scene
    place = np.array(position_of(report, spot))
    upright_from_world = GIVEN_FROM_UPRIGHT.inverse() @ scene.given_from_world
    for pose in scene.world_from_rgb.values():
        eye, truth = report.frame.of(pose.translation), upright_from_world.apply(pose.translation)
        assert place[2] - eye[2] == pytest.approx(SPOT_AT[2] - truth[2], abs=1e-6)  # metres above the camera
        assert np.linalg.norm(place - eye) == pytest.approx(np.linalg.norm(SPOT_AT - truth), abs=1e-6)
    assert position_of(replace(report, subject=None), spot) == spot.position_m  # without a scene, those of the list


@pytest.mark.thorough
def test_a_mark_stands_where_the_finding_is_in_the_picture(scene: Corner) -> None:
    views = marked_views(scene.subject, spot_list(scene).spots)
    assert len(views) == 1 and set(views[0].places) == {1}
    rgb, world = scene.subject.scene.rig.rgb, scene.subject.scene
    at = world.given_from_world.apply_inverse(GIVEN_FROM_UPRIGHT.apply(np.array(SPOT_AT)))
    expected = rgb.project(world.rgb_from_world(views[0].name).apply(at))
    np.testing.assert_allclose(views[0].places[1], expected, atol=1e-6)


@pytest.mark.thorough
def test_a_finding_behind_a_surface_has_no_mark(scene: Corner) -> None:
    spot = spot_list(scene).spots[0]
    below = GIVEN_FROM_UPRIGHT.apply(np.array([0.5, -0.6, -1.0])) * scene.subject.unit_per_sfm
    hidden = replace(spot, position_m=tuple(below.tolist()), best_frames=("elsewhere",))
    assert marked_views(scene.subject, [hidden]) == []
    assert [set(v.places) for v in marked_views(scene.subject, [hidden, spot])] == [{2}]
    shown = replace(hidden, best_frames=(spot.best_frames[0],))  # the list says that this photograph shows it
    assert any(1 in v.places for v in marked_views(scene.subject, [shown]))


@pytest.mark.thorough
def test_pictures_have_their_numbers_and_name_what_they_do_not_show(report: Inspection) -> None:
    page = Report(marks_section(report))
    assert page.marks == ["1", "1"] and len(page.images) == 2 and "No picture shows" not in page.text
    assert "10.0 to 60.0 °C" in page.text
    assert report.spots is not None
    far = replace(report.spots.spots[0], position_m=(900.0, 900.0, 900.0))
    text = Report(marks_section(replace(report, spots=replace(report.spots, spots=(far,))))).text
    assert "No picture shows these findings: 1." in text


@pytest.mark.thorough
def test_the_plan_has_both_views_in_metres(report: Inspection) -> None:
    section = plan_section(report)
    page = Report(section)
    assert "8 camera positions" in page.text and "from how the cameras were held" in page.text
    for words in ("from above", "from the side", "x (m)", "y (m)", "z (m)"):
        assert words in page.text, words
    ids = re.findall(r' id="([^"]+)"', section)
    assert len(ids) == len(set(ids))  # two drawings on one page must not share clip paths
