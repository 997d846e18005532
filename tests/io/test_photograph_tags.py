"""Positions and laser ranges in the tags of photographs: known tags come back, and invalid ones are refused with the reason."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from tests.helpers.metres_scenes import dji_xmp, exif_gps, write_photograph

from rtgs.io.photograph_tags import read_photograph_tags

PLACE = (-33.8568, 151.2153, 12.5)
RADIOMETRIC = Path(os.environ.get("RTGS_DATA", Path(__file__).parents[3] / "shared" / "data")) / "radiometric_jpeg"


def test_exif_of_the_southern_hemisphere(tmp_path: Path) -> None:
    position = read_photograph_tags(write_photograph(tmp_path / "a.jpg", gps=exif_gps(PLACE, error_m=4.0))).position
    assert position is not None
    assert (position.latitude_deg, position.longitude_deg) == pytest.approx(PLACE[:2], abs=1e-8)
    assert position.altitude_m == pytest.approx(12.5) and position.altitude == "sea level"
    assert position.std_m == (4.0, 4.0, 8.0)


def test_altitude_below_the_sea(tmp_path: Path) -> None:
    position = read_photograph_tags(write_photograph(tmp_path / "a.jpg", gps=exif_gps((31.5, 35.5, -420.0)))).position
    assert position is not None and position.altitude_m == pytest.approx(-420) and position.std_m is None


def test_dji_wins_over_exif_and_states_its_accuracy(tmp_path: Path) -> None:
    xmp = dji_xmp(PLACE, (0.011, 0.012, 0.025))
    position = read_photograph_tags(write_photograph(tmp_path / "a.jpg", gps=exif_gps((1.0, 2.0, 3.0)), xmp=xmp)).position
    assert position is not None and position.source == "DJI RTK, fixed" and position.altitude == "ellipsoid"
    assert (position.latitude_deg, position.longitude_deg, position.altitude_m) == pytest.approx(PLACE, abs=1e-9)
    assert position.std_m == (0.011, 0.012, 0.025)  # east, north, up


def test_dji_xmp_as_elements_and_with_the_misspelt_longitude(tmp_path: Path) -> None:
    xmp = "<drone-dji:GpsLatitude>46.5</drone-dji:GpsLatitude><drone-dji:GpsLongtitude>11.25</drone-dji:GpsLongtitude>"
    position = read_photograph_tags(write_photograph(tmp_path / "a.jpg", xmp=xmp)).position
    assert position is not None and (position.latitude_deg, position.longitude_deg) == (46.5, 11.25)
    assert position.altitude_m is None


def test_rtk_that_failed_states_no_accuracy(tmp_path: Path) -> None:
    xmp = dji_xmp(PLACE, (0.01, 0.01, 0.02)).replace('RtkFlag="50"', 'RtkFlag="0"')
    position = read_photograph_tags(write_photograph(tmp_path / "a.jpg", xmp=xmp)).position
    assert position is not None and position.std_m is None and position.source == "DJI GPS"


@pytest.mark.parametrize(
    ("gps", "xmp", "said"),
    [
        (exif_gps(PLACE) | {9: "V"}, "", "no fix"),
        (exif_gps((0.0, 0.0, 5.0)), "", "without a fix"),
        (exif_gps(PLACE) | {2: (97.0, 0.0, 0.0)}, "", "no place"),
        (None, dji_xmp(PLACE, GpsStatus="Invalid"), "Invalid"),
        (None, dji_xmp((0.0, 0.0, 3.0)), "without a fix"),
    ],
    ids=["void", "zero", "impossible", "dji-invalid", "dji-zero"],
)
def test_positions_that_are_none_are_refused(tmp_path: Path, gps: dict[int, object] | None, xmp: str, said: str) -> None:
    tags = read_photograph_tags(write_photograph(tmp_path / "a.jpg", gps=gps, xmp=xmp))
    assert tags.position is None and said in tags.position_refused


def test_a_laser_range(tmp_path: Path) -> None:
    xmp = dji_xmp(LRFStatus="Normal", LRFTargetDistance="45.731")
    assert read_photograph_tags(write_photograph(tmp_path / "a.jpg", xmp=xmp)).laser_m == 45.731


@pytest.mark.parametrize(
    ("status", "metres"), [("NoSignal", "45.7"), ("TooClose", "0"), ("Normal", "0.000"), ("Normal", "9999.9"), ("Normal", "nan")]
)
def test_laser_ranges_that_are_none_are_refused(tmp_path: Path, status: str, metres: str) -> None:
    tags = read_photograph_tags(write_photograph(tmp_path / "a.jpg", xmp=dji_xmp(LRFStatus=status, LRFTargetDistance=metres)))
    assert tags.laser_m is None and tags.laser_refused


def test_a_photograph_without_tags_says_nothing(tmp_path: Path) -> None:
    tags = read_photograph_tags(write_photograph(tmp_path / "a.jpg"))
    assert (tags.position, tags.position_refused, tags.laser_m, tags.laser_refused) == (None, "", None, "")


@pytest.mark.skipif(not RADIOMETRIC.is_dir(), reason="the radiometric JPEGs are not here (RTGS_DATA or ../shared/data)")
@pytest.mark.parametrize(
    ("name", "place", "source"),
    [
        ("DJI_H20T.jpg", (40.5637811, -79.7649628, 221.404), "DJI GPS"),
        ("DJI_XT2.jpg", (9.972157, 76.377786, 39.1), "EXIF GPS"),
        ("FLIR.jpg", (49.0107, 8.4183667, None), "EXIF GPS"),
    ],
)
def test_files_of_real_cameras(name: str, place: tuple[float, float, float | None], source: str) -> None:
    position = read_photograph_tags(RADIOMETRIC / name).position
    assert position is not None and position.source == source
    assert (position.latitude_deg, position.longitude_deg) == pytest.approx(place[:2], abs=2e-6)
    assert position.altitude_m == place[2]
