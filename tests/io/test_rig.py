"""`rig.json`: what it may say, and what each wrong field is answered with."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from tests.helpers.captures import NAMES, RADIOMETRY, RGB, RGB_FROM_THERMAL, THERMAL, edit_rig, refused, thermal_counts

from rtgs.base.errors import RtgsError
from rtgs.io.capture import load_capture
from rtgs.io.rig import read_rig, write_rig
from rtgs.records.radiometry import Atmosphere, ObjectParameters, PlanckCalibration, PlanckRadiometry, RelativeCounts
from rtgs.records.rig import CalibrationStd, Rig

PLANCK = PlanckRadiometry(
    PlanckCalibration(15848.85, 0.014533, 1414.9, 1.0, -4405, Atmosphere(alpha1=0.0066)),
    ObjectParameters(0.95, 22.0, 18.0, 2.0, 0.4, 20.0, 0.98),
)


def test_either_direction_of_the_rig_transform(root: Path) -> None:
    def invert(data: dict[str, Any]) -> None:
        data["thermal_from_rgb"] = np.linalg.inv(np.array(data.pop("rgb_from_thermal"))).tolist()

    edit_rig(root, invert)
    np.testing.assert_allclose(load_capture(root).rig.rgb_from_thermal.matrix(), RGB_FROM_THERMAL.matrix(), atol=1e-12)


def test_a_printed_rotation_is_made_orthonormal(root: Path) -> None:
    edit_rig(root, lambda d: d.update(rgb_from_thermal=np.round(RGB_FROM_THERMAL.matrix(), 4).tolist()))
    rotation = load_capture(root).rig.rgb_from_thermal.rotation
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-14)


def test_centikelvin(root: Path) -> None:
    def use_unit(data: dict[str, Any]) -> None:
        del data["thermal"]["celsius_per_count"], data["thermal"]["celsius_offset"]
        data["thermal"]["unit"] = "centikelvin"

    edit_rig(root, use_unit)
    for i, name in enumerate(NAMES):
        Image.fromarray(thermal_counts(29815 + i)).save(root / "thermal" / f"{name}.tiff")
    np.testing.assert_allclose(load_capture(root).frames[0].thermal, (thermal_counts(29815) - 27315) / 100, atol=1e-5)


def use_planck(root: Path, change: Callable[[dict[str, Any]], Any] = lambda thermal: None) -> None:
    """Thermal files of 30.00, 30.01, … °C (last row 1 °C more) as a camera with Planck constants stores them, and the rig that says so."""
    write_rig(root / "rig.json", Rig(RGB, THERMAL, RGB_FROM_THERMAL), PLANCK)
    for i, name in enumerate(NAMES):
        temperature_c = np.full((32, 40), 30.0 + 0.01 * i)
        temperature_c[-1] += 1
        Image.fromarray(PLANCK.counts(temperature_c).astype(np.float32)).save(root / "thermal" / f"{name}.tiff")
    edit_rig(root, lambda d: change(d["thermal"]))


def test_planck_constants_and_object_parameters(root: Path) -> None:
    use_planck(root)
    assert read_rig(root / "rig.json").radiometry == PLANCK
    capture = load_capture(root)
    assert capture.radiometry.unit == "°C" and capture.warnings == ()
    assert capture.frames[2].thermal.dtype == np.float32
    np.testing.assert_allclose(capture.frames[2].thermal[:-1], 30.02, atol=2e-4)  # the float32 signal of the file: 0.001 counts


def test_another_emissivity_in_the_rig_file_changes_temperatures_as_the_formula_says(root: Path) -> None:
    use_planck(root, lambda thermal: thermal["object"].update(emissivity=0.7, reflected_c=-20.0))
    expected = PLANCK.reevaluated(np.array([30.0]), emissivity=0.7, reflected_c=-20.0)
    assert expected > 40
    np.testing.assert_allclose(load_capture(root).frames[0].thermal[:-1], expected[0], atol=5e-4)


def test_atmosphere_defaults_to_flirs(root: Path) -> None:
    use_planck(root, lambda thermal: [thermal["planck"].pop(k) for k in ("alpha1", "alpha2", "beta1", "beta2", "x")])
    radiometry = read_rig(root / "rig.json").radiometry
    assert isinstance(radiometry, PlanckRadiometry) and radiometry.calibration.atmosphere == Atmosphere()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t.pop("object"), "thermal.object is missing; it holds emissivity, reflected_c"),
        (lambda t: t.pop("planck"), "thermal.object needs thermal.planck"),
        (lambda t: t.update(planck=3), "thermal.planck is not an object {…}"),
        (lambda t: t["planck"].pop("r2"), "thermal.planck.r2 is missing"),
        (lambda t: t["planck"].update(b=0), "thermal.planck.b is 0; a Planck constant is a finite number above 0"),
        (lambda t: t["object"].update(emissivity=95), "thermal.object.emissivity is 95; it is above 0 and at most 1"),
        (lambda t: t["object"].update(emissivity="0.95"), "thermal.object.emissivity is '0.95'; a finite number is expected"),
        (lambda t: t["object"].update(relative_humidity=50), "not per cent"),
        (lambda t: t.update(unit="centikelvin"), "thermal.planck and thermal.unit are both given"),
        (lambda t: t.update(celsius_offset=0), "thermal.planck and thermal.celsius_offset are both given"),
    ],
)
def test_wrong_planck_blocks_are_refused(root: Path, change: Callable[[dict[str, Any]], Any], said: str) -> None:
    use_planck(root, change)
    refused(root, "rig.json", said)


def test_parameters_that_leave_no_temperature_are_refused(root: Path) -> None:
    use_planck(root, lambda thermal: thermal["object"].update(emissivity=0.01, reflected_c=80.0))
    refused(root, f"{NAMES[0]}.tiff", "100.0% of its pixels", "Is object.emissivity too low")


def test_unknown_planck_fields_warn(root: Path) -> None:
    use_planck(root, lambda thermal: thermal["object"].update(emisivity=0.9))
    assert any("thermal.object.emisivity is not a known field" in w for w in load_capture(root).warnings)


def test_without_radiometry_counts_are_relative(root: Path) -> None:
    edit_rig(root, lambda d: (d["thermal"].pop("celsius_per_count"), d["thermal"].pop("celsius_offset")))
    capture = load_capture(root)
    assert capture.radiometry == RelativeCounts() and capture.radiometry.unit == "counts"
    np.testing.assert_array_equal(capture.frames[2].thermal, thermal_counts(4802))


def test_rig_file_round_trip(root: Path) -> None:
    rig_file = read_rig(root / "rig.json")
    assert (rig_file.rig.rgb, rig_file.rig.thermal, rig_file.radiometry) == (RGB, THERMAL, RADIOMETRY)
    np.testing.assert_allclose(rig_file.rig.baseline_m, np.linalg.norm(RGB_FROM_THERMAL.translation))


def test_how_well_the_rig_is_calibrated_comes_through(root: Path, tmp_path: Path) -> None:
    assert load_capture(root).rig.calibration_std is None
    edit_rig(root, lambda d: d.update(uncertainty={"rotation_deg": 0.1, "baseline_length": 0.01, "scale": 3}))
    capture = load_capture(root)
    expected = CalibrationStd(baseline_length=0.01, rotation_rad=np.radians(0.1))
    assert capture.rig.calibration_std == capture.raw_rig.calibration_std == expected
    assert any("uncertainty.scale is not a known field" in w for w in capture.warnings)
    write_rig(tmp_path / "rig.json", capture.raw_rig, RelativeCounts())
    again = read_rig(tmp_path / "rig.json").rig.calibration_std
    assert again is not None and again.rotation_rad == pytest.approx(expected.rotation_rad, rel=1e-12)


@pytest.mark.parametrize("value", [-0.1, "much", None])
def test_an_uncertainty_that_is_none(root: Path, value: Any) -> None:
    edit_rig(root, lambda d: d.update(uncertainty={"rotation_deg": value}))
    with pytest.raises(RtgsError, match=r"rig.json.*uncertainty\.rotation_deg"):
        load_capture(root)
    edit_rig(root, lambda d: d.update(uncertainty=0.1))
    with pytest.raises(RtgsError, match="uncertainty is not an object"):
        load_capture(root)


def test_suspicious_rig_fields_warn(root: Path) -> None:
    edit_rig(root, lambda d: d["thermal"].update(celcius=1))
    edit_rig(root, lambda d: d["rgb_from_thermal"][0].__setitem__(3, 50.0))
    warnings = " ".join(load_capture(root).warnings)
    assert "thermal.celcius is not a known field" in warnings
    assert "millimetres" in warnings


def test_missing_rig(root: Path) -> None:
    (root / "rig.json").unlink()
    refused(root, "rig.json: no such file", "both cameras")


def test_rig_is_not_json(root: Path) -> None:
    (root / "rig.json").write_text("{rgb: 1}")
    refused(root, "rig.json: is not valid JSON", "line 1")
    (root / "rig.json").write_text("[1, 2]")
    refused(root, "holds list where a JSON object")


WRONG_RIGS: list[tuple[Callable[[dict[str, Any]], Any], list[str]]] = [
    (lambda d: d.pop("thermal"), ["rig.json: thermal is missing"]),
    (lambda d: d.update(rgb=3), ["rig.json: rgb is not an object"]),
    (lambda d: d["rgb"].pop("model"), ["rgb.model is missing", "OPENCV_FISHEYE"]),
    (
        lambda d: d["rgb"].update(model="KANNALA"),
        ["rgb.model is 'KANNALA'", "SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV"],
    ),
    (lambda d: d["rgb"].pop("fl_x"), ["rig.json: rgb.fl_x is missing"]),
    (lambda d: d["rgb"].pop("k2"), ["rgb.k2 is missing", "write 0"]),
    (lambda d: d["thermal"].update(k1=0.1), ["thermal.k1 is given, but PINHOLE has no such term", "OPENCV"]),
    (
        lambda d: d["rgb"].update(k3=0.1),
        ["rgb.k3 is given, but OPENCV has", "k3 of OPENCV_FISHEYE is another quantity", "fixed at 0"],
    ),
    (
        lambda d: d["rgb"].update(model="OPENCV_FISHEYE", k3=0.0, k4=0.0),
        ["rgb.p1 is given, but OPENCV_FISHEYE has no such term", "k1 to k4 alone"],
    ),
    (lambda d: d["thermal"].update(fl_x=1e-9), ["thermal.fl_x is 1e-09 pixels, for an image of 40×32"]),
    (lambda d: d["thermal"].update(fl_y=1e9), ["thermal.fl_y is 1e+09 pixels, for an image of 40×32"]),
    (lambda d: d["rgb"].update(cx=1e5), ["rgb.cx is 100000 pixels", "another image size"]),
    (lambda d: d["rgb"].update(cy=-49), ["rgb.cy is -49 pixels"]),
    (lambda d: d["rgb"].update(cx="32"), ["rgb.cx is '32'", "finite number"]),
    (lambda d: d["rgb"].update(cx=float("nan")), ["rgb.cx is nan"]),
    (lambda d: d["thermal"].update(fl_y=-45), ["thermal.fl_y is -45", "above 0"]),
    (lambda d: d["thermal"].update(fl_x=0), ["thermal.fl_x is 0"]),
    (lambda d: d["thermal"].update(model="SIMPLE_PINHOLE", fl_x=46), ["thermal.fl_x and fl_y differ", "Use PINHOLE"]),
    (lambda d: d["rgb"].update(width=64.5), ["rgb.width is 64.5", "whole number"]),
    (lambda d: d["rgb"].update(width=128, height=96), ["rgb.width and height say 128×96", "rgb/10-50.0.png is 64×48"]),
    (lambda d: d["thermal"].update(width=32, height=40), ["thermal.width and height say 32×40", "10-50.0.tiff is 40×32"]),
    (lambda d: d.update(thermal_from_rgb=np.eye(4).tolist()), ["exactly one of", "both are given"]),
    (lambda d: d.update(rough=1), ["rig.json: rough is 1"]),
    (lambda d: (d.pop("rgb_from_thermal"), d.update(rough=True)), ["rough is true, but neither"]),
    (lambda d: d.update(baseline_m=0.1), ["baseline_m is given beside rgb_from_thermal", "rough"]),
    (lambda d: (d.pop("rgb_from_thermal"), d.update(baseline_m=-0.1)), ["baseline_m is -0.1", "above 0"]),
    (lambda d: d.update(rgb_from_thermal=np.eye(3).tolist()), ["rgb_from_thermal is not a 4×4 matrix"]),
    (lambda d: d.update(rgb_from_thermal=[[1, 2], [3]]), ["rgb_from_thermal is not a 4×4 matrix"]),
    (lambda d: d["rgb_from_thermal"][0].__setitem__(3, float("inf")), ["rgb_from_thermal holds NaN or infinity"]),
    (
        lambda d: d.update(rgb_from_thermal=np.array(d["rgb_from_thermal"]).T.tolist()),
        ["bottom row of rgb_from_thermal", "transposed"],
    ),
    (lambda d: d["rgb_from_thermal"][0].__setitem__(0, -1.0), ["rgb_from_thermal is no rotation", "determinant"]),
    (lambda d: d.update(rgb_from_thermal=np.eye(4).tolist()), ["translation of rgb_from_thermal is zero", "baseline in metres"]),
    (lambda d: d["thermal"].update(unit="centikelvin"), ["thermal.unit and thermal.celsius_per_count are both given"]),
    (lambda d: d["thermal"].pop("celsius_per_count"), ["thermal.celsius_per_count is missing"]),
    (lambda d: d["thermal"].pop("celsius_offset"), ["thermal.celsius_offset is missing"]),
    (lambda d: d["thermal"].update(celsius_per_count=0), ["celsius_per_count is 0", "above 0"]),
    (
        lambda d: (d["thermal"].pop("celsius_per_count"), d["thermal"].pop("celsius_offset"), d["thermal"].update(unit="kelvin")),
        ["thermal.unit is 'kelvin'", "centikelvin"],
    ),
]


@pytest.mark.parametrize(("change", "said"), WRONG_RIGS, ids=[said[0][:40] for _, said in WRONG_RIGS])
def test_wrong_rig(root: Path, change: Callable[[dict[str, Any]], Any], said: list[str]) -> None:
    edit_rig(root, change)
    refused(root, "rig.json: ", *said)
