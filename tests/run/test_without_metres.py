"""A run of a rig that was found from the capture, where nothing tells metres: all of it works, in SfM units and °C."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from tests.helpers.made_up_run import estimate, make_run, page_of
from tests.helpers.tiny_run import THERMAL_FLAGS, flags, recorded

from rtgs.metres.combine import combine
from rtgs.records.metres import MetresSource
from rtgs.run.folder import RunFolder
from rtgs.scale import ScaleEstimate
from rtgs.scale.records import FoundRig
from rtgs.viewer.contents import read_contents

FAR = FoundRig(False, False, None, None, None, 0.9, 0.9, 1.0, (0.8, 0.1), 9.0)
NEAR = FoundRig(True, True, 0.5, 0.02, None, 0.9, 0.8, 9.0, (0.8, 0.1), 9.0)
DISTANCE = MetresSource("distance 1", 2.0, 0.01, "of a tape measure")


def without(found: FoundRig = FAR, of: ScaleEstimate | None = None) -> ScaleEstimate:
    of = of or estimate()
    ci95 = of.ci95 if found.baseline_decided else None
    return replace(
        of, status="unobservable", reason="it is too far away.", baseline_m=None, ci95=ci95, calibration=found, metres=combine([])
    )


def test_the_sentence_says_what_is_missing_and_what_to_add() -> None:
    far, near = without(), without(NEAR)
    assert far.metres_per_sfm is None and far.length_unit == "SfM units" and far.metres_ci95 is None and far.unit_per_sfm == 1.0
    assert "too far away" in far.no_metres and "known distance" in far.no_metres and "GPS" in far.no_metres
    assert (
        "baseline_m" not in far.no_metres and "baseline_m" in near.no_metres
    )  # where the images do not tell it, a length is no help
    assert near.metres_per_sfm is None


def test_another_source_carries_the_metres_alone() -> None:
    for found in (FAR, NEAR):
        given = replace(without(found), metres=combine([DISTANCE], {"baseline": "it is too far away"}))
        assert given.metres_per_sfm == 0.5 and given.length_unit == "m" and given.no_metres == "" and given.doubt == ""
        assert given.metres_ci95 == DISTANCE.ci95


def test_a_found_baseline_of_known_length_tells_metres_unless_in_doubt() -> None:
    known = replace(estimate(), calibration=replace(NEAR, baseline_m=0.2))
    assert known.metres_per_sfm == 1 / known.sfm_per_metre
    assert replace(known, status="unobservable", ci95=None, reason="two places fit").metres_per_sfm is None


def test_a_control_at_scale_1_needs_a_length_and_a_direction() -> None:
    """One SfM unit for a metre says nothing of a baseline that is not in metres, or that points nowhere."""
    assert estimate().no_control == ""
    assert "how long the baseline is" in without(NEAR).no_control
    assert replace(without(NEAR), baseline_m=0.2).no_control == ""
    assert "direction" in replace(without(FAR), baseline_m=0.2).no_control


def test_the_report_says_why_there_is_no_control(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    assert "control at scale 1 is left out" not in page_of(run).text
    RunFolder(run).write_scale(without(NEAR))
    assert "control at scale 1 is left out" in page_of(run).text


def test_the_report_claims_no_metres(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    RunFolder(run).write_scale(without())
    text = page_of(run).text
    assert "No metres" in text and "known distance" in text and "One metre is" not in text
    assert "SfM units in the baseline" not in text and "the scan" not in text  # the images tell none
    RunFolder(run).write_scale(without(NEAR))
    text = page_of(run).text
    assert "SfM units in the baseline" in text and "the scan" in text
    RunFolder(run).write_scale(replace(without(), metres=combine([DISTANCE])))
    text = page_of(run).text
    assert "One metre is" in text and "2 SfM units" in text and "No metres" not in text


def test_overlays_of_a_found_rig_begin_where_its_search_began(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run", renders=True)
    assert "before: scale ignored" in page_of(run).text
    RunFolder(run).write_scale(without())
    text = page_of(run).text
    assert "before: where the search for the rig began" in text and "after: rig as found" in text
    assert "before: scale ignored" not in text


@pytest.mark.thorough
def test_everything_that_leaves_a_run_works_in_sfm_units(run: Path, tmp_path: Path) -> None:
    folder = RunFolder(run)
    folder.write_scale(without(of=replace(folder.read_scale(), refinement=None)))

    def command(*arguments: str) -> tuple[int, str]:
        recorder, code = recorded([arguments[0], str(run), *arguments[1:]])
        return code, " ".join(str(event) for event in recorder.events)

    assert command("info")[0] == 0
    assert command("export", "--out", str(tmp_path / "no"))[0] == 2 and not (tmp_path / "no").exists()
    code, said = command(
        "export", "--out", str(tmp_path / "sfm"), "--frame", "sfm", "--format", "ply", "glb", "points-ply", "nerfstudio", "colmap"
    )
    assert code == 0 and "SfM units" in said
    assert (
        command("export", "--out", str(tmp_path / "p"), "--frame", "sfm", "--format", "points-ply", "--spacing-m", "0.1")[0] == 2
    )
    code, said = command("spots", "--out", str(tmp_path / "spots"), "--above", "0", "--fewest-views", "1")
    assert code == 0 and " m," not in said
    assert (tmp_path / "spots/spots.csv").read_text().startswith("number,kind,x_sfm,y_sfm,z_sfm,area_sfm2,diameter_sfm,")
    assert json.loads((tmp_path / "spots/spots.json").read_text())["length_unit"] == "SfM units"
    assert "SfM units" in json.loads((tmp_path / "spots/spots.geojson").read_text())["coordinates"]
    code, said = command("share", "--out", str(tmp_path / "page.html"))
    assert code == 0 and "nothing tells metres" in said
    assert '"lengthUnit":"SfM units"' in (tmp_path / "page.html").read_text()
    assert command("render", "--out", str(tmp_path / "views"), "--frames", "frame_001")[0] == 0
    contents = read_contents(run)
    assert contents.length_unit == "SfM units" and contents.world_per_unit == 1 / contents.given_from_world.factor


@pytest.mark.thorough
def test_no_control_is_fitted_where_it_would_mean_nothing(run: Path) -> None:
    folder = RunFolder(run)
    assert (run / "thermal_naive.ply").exists()
    folder.write_scale(without(NEAR, of=replace(folder.read_scale(), refinement=None)))
    (run / "thermal.ply").unlink()
    recorder, code = recorded(["thermal", str(run), *flags(THERMAL_FLAGS)])
    assert code == 0 and recorder.works == ["thermal"]
    assert "the control at scale 1 is left out" in " ".join(str(event) for event in recorder.events)
    assert not list(run.glob("thermal_naive*"))
    assert recorded(["eval", str(run)])[1] == 0
    assert "thermal_naive" not in json.loads((run / "metrics.json").read_text())


@pytest.mark.thorough
def test_metres_of_another_source_are_those_of_the_viewer_and_of_exports(run: Path, tmp_path: Path) -> None:
    folder = RunFolder(run)
    none = without(of=replace(folder.read_scale(), refinement=None))
    folder.write_scale(replace(none, metres=combine([DISTANCE])))
    recorder, code = recorded(["export", str(run), "--out", str(tmp_path / "out")])
    assert code == 0 and "m, y-down" in " ".join(str(event) for event in recorder.events)
    contents = read_contents(run)
    assert contents.metric and contents.world_per_unit == pytest.approx(2.0 / contents.given_from_world.factor)


def test_a_report_for_a_client_is_refused(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    RunFolder(run).write_scale(without())
    _, code = recorded(["report", str(run), "--out", str(tmp_path / "report.html"), "--template", "inspection"])
    assert code == 2 and not (tmp_path / "report.html").exists()
