"""What GPS does to what leaves a run: lengths, places on the Earth, and the file that leads there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.helpers.made_up_run import estimate, make_run

from rtgs.base.json_records import read_json
from rtgs.metres.combine import combine
from rtgs.records.georeference import Georeference
from rtgs.records.metres import MetresSource
from rtgs.records.spots import Spot, SpotList
from rtgs.run.folder import RunFolder
from rtgs.run.spots import COLUMNS, PLACE_COLUMNS, on_the_earth, row_of
from rtgs.run.summary import metres_lines

NORTH = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))  # z of the frame is north, and y down
PLACE = Georeference(46.0, 11.0, 200.0, "ellipsoid", 0.5, NORTH, (0.0, 0.0, 10.0), (0.01, 0.01, 0.02))
SPOT = Spot("hot", (0.0, -2.0, 30.0), 0.01, 40.0, 38.0, 20.0, 0.1, 5, 5, ("a",), 39.0, 0.2)
LISTED = SpotList((SPOT,), "°C", "3 °C or more")


def test_lengths_rest_on_all_sources_and_the_cameras_on_the_images(tmp_path: Path) -> None:
    folder = RunFolder(make_run(tmp_path / "run"))
    folder.write_scale(replace(estimate(), metres=combine([MetresSource("gps", 3.0, 0.01, "RTK")])))
    scale = folder.read_scale()
    assert scale.metres_per_sfm == 1 / 3.0 and scale.sfm_per_metre == estimate().sfm_per_metre
    assert read_json(folder.path / "scale.json")["metres_per_sfm"] == 1 / 3.0
    assert read_json(folder.path / "scale.json")["metres"]["rests_on"] == ["gps"]


def test_a_run_of_images_alone_has_the_lengths_of_its_scale() -> None:
    assert estimate().metres_per_sfm == 1 / estimate().sfm_per_metre and estimate().doubt == ""
    assert replace(estimate(), status="unobservable", reason="flat").doubt == "flat"


def test_a_spot_has_its_place_on_the_earth() -> None:
    spot = on_the_earth(SPOT, PLACE, metres_per_sfm=0.5)
    assert spot.latitude_deg == pytest.approx(46 + 30 / 111_141, abs=1e-7) and spot.longitude_deg == pytest.approx(11.0)
    assert spot.altitude_m == pytest.approx(212.0, abs=1e-3)
    assert len(row_of(1, spot, LISTED)) == len(COLUMNS) + len(PLACE_COLUMNS) and len(row_of(1, SPOT, LISTED)) == len(COLUMNS)


def test_an_export_in_metres_leads_to_the_same_places() -> None:
    points = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose(PLACE.in_unit(0.5).places(points * 0.5), PLACE.places(points), atol=1e-12)


def test_the_terminal_says_nothing_where_the_baseline_is_all_there_is() -> None:
    baseline = MetresSource("baseline", 2.0, 0.01, "edges")
    assert metres_lines(combine([baseline])) == []
    lines = metres_lines(combine([baseline, MetresSource("gps", 2.5, 0.02, "RTK")], {"laser": "NoSignal"}))
    assert any("gps 2.5 ± 2 % (does not count)" in line for line in lines) and any("NoSignal" in line for line in lines)
