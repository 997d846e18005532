"""The place of a scene on the Earth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import read_record, write_json
from rtgs.maths.geometry import rotation_from_axis_angle
from rtgs.maths.wgs84 import enu_from_places
from rtgs.records.georeference import Georeference

ROTATION = rotation_from_axis_angle([0.4, -1.2, 0.3])


def _row(i: int) -> tuple[float, float, float]:
    x, y, z = ROTATION[i].tolist()
    return x, y, z


HERE = Georeference(
    latitude_deg=46.067,
    longitude_deg=11.121,
    altitude_m=194.0,
    altitude="ellipsoid",
    metres_per_sfm=2.5,
    rotation=(_row(0), _row(1), _row(2)),
    translation_m=(3.0, -4.0, 1.5),
    std_m=(0.01, 0.01, 0.03),
)


def test_places_are_the_points_carried_to_the_earth() -> None:
    points = np.random.default_rng(1).normal(size=(20, 3))
    expected = 2.5 * points @ ROTATION.T + [3.0, -4.0, 1.5]
    origin = (HERE.latitude_deg, HERE.longitude_deg, HERE.altitude_m)
    np.testing.assert_allclose(enu_from_places(HERE.places(points), origin), expected, atol=1e-7)


def test_up_is_the_direction_that_gains_altitude() -> None:
    higher = HERE.enu(np.array(HERE.up)) - HERE.enu(np.zeros(3))
    np.testing.assert_allclose(higher, [0, 0, 2.5], atol=1e-12)


def test_the_file_keeps_every_digit(tmp_path: Path) -> None:
    write_json(tmp_path / "georeference.json", HERE)
    assert read_record(Georeference, tmp_path / "georeference.json") == HERE


@pytest.mark.parametrize(
    "wrong", [{"latitude_deg": 91.0}, {"metres_per_sfm": 0.0}, {"rotation": ((1.0, 0.0, 0.0),) * 3}], ids=lambda d: next(iter(d))
)
def test_what_is_no_place_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(RtgsError, match=next(iter(wrong))):
        replace(HERE, **wrong)  # type: ignore[arg-type]
