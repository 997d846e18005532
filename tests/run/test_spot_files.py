"""Crops show the spot under the mark, in both photographs; GeoJSON has its place."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from tests.helpers.wall_with_spots import SFM_PER_METRE, SPOTS, photographed, wall

from rtgs.base.json_records import write_json
from rtgs.maths.geometry import Sim3
from rtgs.maths.wgs84 import places_from_enu
from rtgs.records.georeference import Georeference
from rtgs.records.scene import Scene
from rtgs.records.spots import ReferenceTemperature, Spot, SpotList
from rtgs.run.spot_files import CROP_PX, draw_crops, geojson_of
from rtgs.run.spots import on_the_earth

PLACE = Georeference(46.0, 11.0, 200.0, "ellipsoid", 0.4, ((0, 1, 0), (-1, 0, 0), (0, 0, 1)), (5.0, -3.0, 2.0), (0.01,) * 3)


def spots_on_the_wall(frame: str) -> SpotList:
    """The truth: one warm spot, one cold."""
    spots = [
        Spot(
            "hot" if height > 0 else "cold",
            (x, y, 0.0),
            math.pi * (fwhm / 2) ** 2,
            20 + height,
            20 + height / 2,
            20.0,
            0.1,
            9,
            9,
            (frame,),
            30.0,
            0.2,
        )
        for (x, y), height, fwhm in SPOTS
    ]
    return SpotList(tuple(spots), "°C", "as planted", ReferenceTemperature("wall", 20.0))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return photographed(wall(SPOTS))


def halves(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """RGB and thermal crop, `[CROP_PX, CROP_PX, 3]`."""
    picture = np.asarray(Image.open(path), np.float64)
    top = picture.shape[0] - CROP_PX
    marked = np.flatnonzero(is_mark(picture).any(axis=0))
    right = marked[marked > CROP_PX].min() - (marked[marked < CROP_PX].min())
    return picture[top:, :CROP_PX], picture[top:, right : right + CROP_PX]


def is_mark(picture: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (picture == [0, 255, 160]).all(axis=-1)


@pytest.mark.thorough
@pytest.mark.parametrize("moved", [False, True])
def test_the_ring_lies_around_the_spot_in_both_photographs(scene: Scene, tmp_path: Path, moved: bool) -> None:
    shift = np.array([30.0, -20.0, 7.0]) if moved else np.zeros(3)
    scene = replace(scene, given_from_world=Sim3(1.0, np.eye(3), shift * SFM_PER_METRE))
    listed = spots_on_the_wall(scene.train_frames[3].name)
    placed = [replace(s, position_m=tuple((np.array(s.position_m) + shift).tolist())) for s in listed.spots]
    draw_crops(tmp_path, scene, replace(listed, spots=tuple(placed)), SFM_PER_METRE, 1 / SFM_PER_METRE)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["001.png", "002.png"]
    for number, spot in enumerate(listed.spots, start=1):
        for half in halves(tmp_path / f"{number:03d}.png"):
            ring = np.argwhere(is_mark(half))
            middle, radius = (ring.min(0) + ring.max(0)) / 2, np.ptp(ring, axis=0).mean() / 2
            gray = half.sum(axis=-1)
            assert gray.std() > 15  # not blank
            y, x = np.mgrid[:CROP_PX, :CROP_PX]
            inside = np.hypot(y - middle[0], x - middle[1]) < radius - 4
            around = np.abs(np.hypot(y - middle[0], x - middle[1]) - 1.8 * radius) < 0.2 * radius
            weight = np.abs(gray - np.median(gray[around])) * inside
            centre = (weight * y).sum() / weight.sum(), (weight * x).sum() / weight.sum()
            np.testing.assert_allclose(centre, middle, atol=0.25 * radius)
            sign = 1 if spot.kind == "hot" else -1
            assert sign * (np.median(gray[inside]) - np.median(gray[around])) > 15


def test_geojson_is_valid_and_has_the_places(tmp_path: Path) -> None:
    listed = spots_on_the_wall("a")
    placed = replace(listed, spots=tuple(on_the_earth(s, PLACE, 0.5) for s in listed.spots))
    write_json(tmp_path / "spots.geojson", geojson_of(placed))
    data = json.loads((tmp_path / "spots.geojson").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert data["type"] == "FeatureCollection" and len(data["features"]) == 2 and "WGS 84" in data["coordinates"]
    assert data["reference"]["name"] == "wall"
    for number, (feature, ((x, y), height, _)) in enumerate(zip(data["features"], SPOTS, strict=True), start=1):
        assert feature["type"] == "Feature" and feature["geometry"]["type"] == "Point"
        longitude, latitude, altitude = feature["geometry"]["coordinates"]
        east, north, up = 0.4 * y / 0.5 + 5, -0.4 * x / 0.5 - 3, 2.0  # metres of the list are divided by its metres per unit
        known = places_from_enu([[east, north, up]], [46.0, 11.0, 200.0])[0]
        assert (latitude, longitude) == pytest.approx((known[0], known[1]), abs=1e-9) and altitude == pytest.approx(
            known[2], abs=1e-4
        )
        assert latitude == pytest.approx(46 + north / 111_147, abs=1e-7)  # metres to a degree at 46° north
        assert longitude == pytest.approx(11 + east / 77_465, abs=1e-7)
        assert feature["properties"]["number"] == number and feature["properties"]["off_reference"] == pytest.approx(height)


def test_without_a_place_on_the_earth_coordinates_are_those_of_the_poses() -> None:
    listed = spots_on_the_wall("a")
    data = geojson_of(listed)
    assert (
        data["features"][0]["geometry"]["coordinates"] == [*SPOTS[0][0], 0.0]
        and "metres, frame of the poses" in data["coordinates"]
    )
    assert "SfM units" in geojson_of(replace(listed, length_unit="SfM units"))["coordinates"]
