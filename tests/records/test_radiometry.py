"""Laws of counts and °C: inverses, limits, and what each object parameter does."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from rtgs.base.errors import RtgsError
from rtgs.records.radiometry import (
    CENTIKELVIN,
    Atmosphere,
    CelsiusRadiometry,
    CountsToCelsius,
    ObjectParameters,
    PlanckCalibration,
    PlanckRadiometry,
    Radiometry,
    RelativeCounts,
)

# Constants of three cameras, as their files give them: a T640, an E40 and an XT2.
CALIBRATIONS = (
    PlanckCalibration(15848.853515625, 0.014533111825585365, 1414.9000244140625, 1.0, -4405),
    PlanckCalibration(14866.513671875, 0.01108647882938385, 1395.699951171875, 1.0, -5859),
    PlanckCalibration(17096.453125, 0.046582058, 1428.0, 1.0, -267),
)
PARAMETERS = (
    ObjectParameters(),
    ObjectParameters(0.95, 20.0, 20.0, 1.0, 0.5, 20.0, 1.0),
    ObjectParameters(0.6, -30.0, 5.0, 40.0, 0.8, 35.0, 0.85),
)
MODELS: tuple[CelsiusRadiometry, ...] = (
    CENTIKELVIN,
    CountsToCelsius(0.025, -100.0),
    *(PlanckRadiometry(c, p) for c in CALIBRATIONS for p in PARAMETERS),
)
TEMPERATURES_C = np.array([-60.0, -20.0, 0.0, 20.0, 36.6, 100.0, 350.0])


@pytest.mark.parametrize("model", MODELS)
def test_counts_and_celsius_are_inverse(model: CelsiusRadiometry) -> None:
    # celsius() is float32: half a unit in the last place at 350 °C is 1.5e-5.
    np.testing.assert_allclose(model.celsius(model.counts(TEMPERATURES_C)), TEMPERATURES_C, atol=2e-5)


@pytest.mark.parametrize("calibration", CALIBRATIONS)
def test_black_body_is_inverse_in_float64(calibration: PlanckCalibration) -> None:
    back = calibration.blackbody_celsius(calibration.blackbody_signal(TEMPERATURES_C))
    np.testing.assert_allclose(back, TEMPERATURES_C, atol=1e-9)
    signal = np.linspace(-calibration.o + 1, 65535, 50)
    np.testing.assert_allclose(calibration.blackbody_signal(calibration.blackbody_celsius(signal)), signal, rtol=1e-10)


@pytest.mark.parametrize("model", MODELS)
def test_more_counts_are_warmer(model: CelsiusRadiometry) -> None:
    low, high = model.counts(np.array([-60.0, 350.0]))
    counts = np.linspace(low, high, 1000)
    assert (np.diff(model.celsius(counts)) > 0).all()


@pytest.mark.parametrize("shape", [(), (7,), (3, 5)])
@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.float32, np.float64])
def test_any_shape_and_number_type(shape: tuple[int, ...], dtype: type) -> None:
    for model in MODELS:
        celsius = model.celsius(np.full(shape, 15000, dtype=dtype))
        assert celsius.shape == shape and celsius.dtype == np.float32
        np.testing.assert_allclose(celsius, model.celsius(np.array([15000.0]))[0])


def test_known_answer() -> None:
    """The E40's own constants at 20 °C, worked by hand: exp(1395.7 / 293.15) = 116.846…, so R1 / (R2 · 115.846) + 5859."""
    by_hand = 14866.513671875 / (0.01108647882938385 * (np.exp(1395.699951171875 / 293.15) - 1)) + 5859
    np.testing.assert_allclose(CALIBRATIONS[1].blackbody_signal(20.0), by_hand, rtol=1e-14)
    assert 17000 < by_hand < 18000  # the file's median count, at a median of 21 °C, is 17622


@pytest.mark.parametrize("calibration", CALIBRATIONS)
def test_black_body_without_air_and_window_is_planck_alone(calibration: PlanckCalibration) -> None:
    """With emissivity 1 nothing is reflected, so the reflected temperature has no say."""
    for reflected_c in (-40.0, 20.0, 90.0):
        radiometry = PlanckRadiometry(calibration, ObjectParameters(emissivity=1.0, reflected_c=reflected_c))
        np.testing.assert_allclose(radiometry.counts(TEMPERATURES_C), calibration.blackbody_signal(TEMPERATURES_C), rtol=1e-14)


@pytest.mark.parametrize("emissivity", [0.3, 0.8, 1.0])
def test_in_equilibrium_no_parameter_matters(emissivity: float) -> None:
    """When object, surroundings, air and window share one temperature, the camera sees a black body of it."""
    for calibration in CALIBRATIONS:
        parameters = ObjectParameters(emissivity, 31.0, 31.0, 15.0, 0.6, 31.0, 0.7)
        signal = PlanckRadiometry(calibration, parameters).counts(np.array([31.0]))
        np.testing.assert_allclose(signal, calibration.blackbody_signal(31.0), rtol=1e-12)


def test_signal_is_the_mixture_that_the_formula_says() -> None:
    """Emitted and reflected parts without air: S = ε U(T) + (1 − ε) U(T_reflected)."""
    calibration = CALIBRATIONS[0]
    radiometry = PlanckRadiometry(calibration, ObjectParameters(emissivity=0.7, reflected_c=-10.0))
    emitted, reflected = calibration.blackbody_signal(60.0), calibration.blackbody_signal(-10.0)
    np.testing.assert_allclose(radiometry.counts(np.array([60.0])), 0.7 * emitted + 0.3 * reflected, rtol=1e-14)


@pytest.mark.parametrize(
    ("changed", "sign"),
    [
        ({"emissivity": 0.8}, +1),  # a warm object that emits less must be warmer to give the same signal
        ({"reflected_c": 40.0}, -1),  # more of the signal is reflected, so less is emitted
        ({"distance_m": 30.0}, +1),  # air at 20 °C has taken away more of what 60 °C gave
        ({"window_transmission": 0.8}, +1),
    ],
)
def test_what_each_parameter_does_to_a_warm_object(changed: dict[str, float], sign: int) -> None:
    radiometry = PlanckRadiometry(CALIBRATIONS[1], PARAMETERS[1])
    after = radiometry.reevaluated(np.array([60.0]), **changed)
    assert sign * (after - 60.0) > 0.1


def test_reevaluation_is_a_new_reading_of_the_same_counts() -> None:
    counts = np.arange(15000, 30000, 997, dtype=np.uint16)
    radiometry = PlanckRadiometry(CALIBRATIONS[0], PARAMETERS[1])
    other = replace(radiometry, parameters=replace(PARAMETERS[1], emissivity=0.75, reflected_c=-5.0))
    reevaluated = radiometry.reevaluated(radiometry.celsius(counts), emissivity=0.75, reflected_c=-5.0)
    np.testing.assert_allclose(reevaluated, other.celsius(counts), atol=1e-4)  # once more through float32 °C
    assert np.abs(reevaluated - radiometry.celsius(counts)).max() > 1.0
    same = radiometry.reevaluated(radiometry.celsius(counts))
    np.testing.assert_allclose(same, radiometry.celsius(counts), atol=5e-5)


def test_air_transmits_less_over_a_longer_way() -> None:
    tau = [Atmosphere().transmission(d, 20.0, 0.5) for d in (0.0, 1.0, 10.0, 100.0)]
    assert tau[0] == 1.0
    assert (np.diff(tau) < 0).all()
    # FLIR's defaults, 1 m, 20 °C, 50 %: ω = 0.5 · exp(1.5587 + 1.3878 − 0.111264 + 0.005476) = 8.567 g/m³.
    root_water = np.sqrt(0.5 * np.exp(1.5587 + 1.3878 - 0.111264 + 0.0054764))
    by_hand = 1.9 * np.exp(-(0.006569 - 0.002276 * root_water)) - 0.9 * np.exp(-(0.01262 - 0.00667 * root_water))
    np.testing.assert_allclose(tau[1], by_hand, rtol=1e-9)


def test_a_signal_below_every_temperature_is_absolute_zero() -> None:
    """With ε = 0.1 in front of a hot background, a small signal cannot be explained; it is no NaN and no warning."""
    radiometry = PlanckRadiometry(CALIBRATIONS[0], ObjectParameters(emissivity=0.1, reflected_c=80.0))
    celsius = radiometry.celsius(np.array([0, 5000, 60000], dtype=np.uint16))
    np.testing.assert_allclose(celsius[:2], -273.15)
    assert celsius[2] > 0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("emissivity", 0.0),
        ("emissivity", 1.01),
        ("emissivity", float("nan")),
        ("window_transmission", 0.0),
        ("relative_humidity", 50.0),
        ("distance_m", -1.0),
        ("reflected_c", -274.0),
        ("atmospheric_c", float("nan")),
        ("window_c", float("inf")),
    ],
)
def test_impossible_parameters_are_refused_by_name(name: str, value: float) -> None:
    assert name in {f.name for f in fields(ObjectParameters)}
    with pytest.raises(RtgsError, match=rf"object\.{name} is "):
        replace(PARAMETERS[1], **{name: value})


@pytest.mark.parametrize("name", ["r1", "r2", "b", "f", "o"])
def test_impossible_constants_are_refused_by_name(name: str) -> None:
    wrong: dict[str, Any] = {name: float("nan")}
    with pytest.raises(RtgsError, match=rf"planck\.{name} is nan"):
        replace(CALIBRATIONS[0], **wrong)


def test_air_beyond_the_formula_is_refused() -> None:
    for air in (
        {"atmospheric_c": 60.0, "distance_m": 2000.0, "relative_humidity": 1.0},
        {"atmospheric_c": 1e5, "distance_m": 1.0},
    ):
        with pytest.raises(RtgsError, match="transmission of air"):
            PlanckRadiometry(CALIBRATIONS[0], replace(PARAMETERS[1], **air))


@pytest.mark.parametrize(("radiometry", "unit", "suffix"), [(RelativeCounts(), "counts", "counts"), (CENTIKELVIN, "°C", "c")])
def test_a_radiometry_says_the_unit_of_its_values(radiometry: Radiometry, unit: str, suffix: str) -> None:
    values = radiometry.values(np.array([0, 30000], np.uint16))
    assert (radiometry.unit, radiometry.suffix, values.dtype) == (unit, suffix, np.float32)
    np.testing.assert_allclose(values, [0, 30000] if unit == "counts" else [-273.15, 26.85], atol=1e-4)


def test_every_16_bit_count_comes_back() -> None:
    counts = np.arange(65536)
    np.testing.assert_allclose(CENTIKELVIN.counts(CENTIKELVIN.celsius(counts)), counts, atol=2e-3)
