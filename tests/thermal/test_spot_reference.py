"""What spots are compared with: a temperature, or a region whose temperature is measured in the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.scene_record import altered
from tests.helpers.wall_with_spots import CAMERA, SFM_PER_METRE, photographed, wall

from rtgs.base.errors import RtgsError
from rtgs.config import SpotsConfig
from rtgs.config.spots import Reference, parse_reference
from rtgs.maths.geometry import Sim3
from rtgs.models import ThermalModel
from rtgs.records.scene import Scene
from rtgs.records.spots import ReferenceTemperature
from rtgs.thermal.spots import find_spots

PATCH = ((0.0, -0.35), 5.0, 0.3)  # metres on the wall, °C, FWHM: warm, and too weak for the list


@pytest.fixture(scope="module")
def known() -> tuple[Scene, ThermalModel]:
    model = wall([((0.25, 0.10), 12.0, 0.12), PATCH])
    return photographed(model), model


def reference_of(scene: Scene, model: ThermalModel, what: str) -> ReferenceTemperature:
    found = find_spots(scene, model, SpotsConfig(reference=what, excess=8.0)).reference
    assert found is not None
    return found


def test_what_is_written() -> None:
    assert parse_reference("21") == Reference("", temperature=21.0) and parse_reference("air=-3.5") == Reference("air", -3.5)
    assert parse_reference("the wall=a:b.c:1,2,30,40") == Reference("the wall", frame="a:b.c", box=(1, 2, 30, 40))
    assert parse_reference("0.1,-2,3,0.05") == Reference("", place=(0.1, -2.0, 3.0), radius=0.05)


@pytest.mark.parametrize(
    "text", ["", "warm", "nan", "a=", "f:1,2,3", "f:5,0,5,4", "f:0,0,1.5,4", "f:-1,0,4,4", "1,2,3,0", "1,2,3", "1,2,3,inf"]
)
def test_what_is_no_reference_is_refused(text: str) -> None:
    with pytest.raises(RtgsError, match=r"spots\.reference is .*LEFT,TOP,RIGHT,BOTTOM"):
        SpotsConfig(reference=text)


@pytest.mark.thorough
def test_a_place_is_measured_in_all_views_that_see_it(known: tuple[Scene, ThermalModel]) -> None:
    scene, model = known
    found = reference_of(scene, model, "patch=0,-0.35,0,0.02")
    assert found.name == "patch" and found.temperature == pytest.approx(25.0, abs=0.3)
    assert found.std is not None and found.std < 0.01 and found.views >= 6
    elsewhere = reference_of(scene, model, "-0.4,0.3,0,0.03")
    assert elsewhere.temperature == pytest.approx(20.0, abs=0.1)
    given = Sim3(1.0, np.eye(3), np.array([500.0, 400.0, 100.0]))
    x, y, z = (v / SFM_PER_METRE for v in given.translation)
    moved = reference_of(replace(scene, given_from_world=given), model, f"{x},{y - 0.35},{z},0.02")
    assert moved.temperature == pytest.approx(found.temperature, abs=1e-3)


@pytest.mark.thorough
def test_a_rectangle_of_a_frame_is_found_in_the_other_views(known: tuple[Scene, ThermalModel]) -> None:
    scene, model = known
    name = scene.frames[0].name  # held out; its pose is known all the same
    x, y = CAMERA.project(scene.thermal_from_world(name, SFM_PER_METRE).apply(SFM_PER_METRE * np.array([0.0, -0.35, 0.0])))
    box = f"{name}:{int(x) - 1},{int(y) - 1},{int(x) + 2},{int(y) + 2}"
    found = reference_of(scene, model, box)
    assert found.temperature == pytest.approx(25.0, abs=0.4) and found.views >= 6 and found.name == ""


@pytest.mark.thorough
def test_the_standard_error_is_how_far_the_model_is_off_the_photographs(known: tuple[Scene, ThermalModel]) -> None:
    scene, model = known
    warmer = altered(scene, thermal={f.name: f.thermal + 0.5 for f in scene.frames})
    found = reference_of(warmer, model, "-0.4,0.3,0,0.03")
    assert found.std == pytest.approx(0.5, abs=0.01) and found.temperature == pytest.approx(20.0, abs=0.1)


def test_what_is_not_there_is_refused(known: tuple[Scene, ThermalModel]) -> None:
    scene, model = known
    for what, why in (("x:0,0,4,4", "no frame x"), ("000:90,0,99,4", "96 × 80 pixels"), ("9,9,9,0.1", "no training photograph")):
        with pytest.raises(RtgsError, match=why):
            find_spots(scene, model, SpotsConfig(reference=what))


@pytest.mark.thorough
def test_spots_are_compared_with_it(known: tuple[Scene, ThermalModel]) -> None:
    scene, model = known
    found = find_spots(scene, model, SpotsConfig(reference="0,-0.35,0,0.02", excess=8.0))
    assert found.reference is not None and len(found.spots) == 1
    assert found.off_reference(found.spots[0]) == pytest.approx(7.0, abs=1.0)
    assert replace(found, reference=None).off_reference(found.spots[0]) is None
