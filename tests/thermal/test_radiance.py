"""Captures with Planck constants are fitted in radiance: what mixes in a pixel is signal, and not °C."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.helpers.scene_record import altered
from tests.helpers.thermal_scenes import RIG, SFM_PER_METRE, held_out_error_c, ring

from rtgs.base.errors import RtgsError
from rtgs.config import ThermalConfig
from rtgs.io.capture import load_capture
from rtgs.io.rig import write_rig
from rtgs.maths.geometry import Sim3
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.radiometry import (
    CELSIUS,
    CENTIKELVIN,
    CountsToCelsius,
    LinearRange,
    ObjectParameters,
    PlanckCalibration,
    PlanckRadiometry,
    PlanckRange,
    extended,
)
from rtgs.records.scene import Scene
from rtgs.run.folder import RunFolder
from rtgs.thermal import fit_thermal, gaussian_temperatures
from rtgs.thermal.frames import color_range
from rtgs.thermal.settings import CertaintySettings

CALIBRATION = PlanckCalibration(r1=15848.854, r2=0.014533112, b=1414.9, f=1.0, o=-4405.0)  # a FLIR E40's
CAMERA = PlanckRadiometry(CALIBRATION, ObjectParameters(emissivity=0.95, reflected_c=20.0, distance_m=1.0))
HOT = LinearRange(15.0, 120.0)


@lru_cache(maxsize=1)
def mixed() -> tuple[Scene, RgbModel, ThermalModel]:
    """The ball of `ring` at 15 to 120 °C: its pixels are mixtures of hot and cold, as a camera mixes them."""
    scene, rgb, truth = ring()
    truth = replace(truth, range=HOT, color_range=PlanckRange.of(CALIBRATION, HOT))
    images = {f.name: truth.render(RIG.thermal, scene.thermal_from_world(f.name, SFM_PER_METRE)) for f in scene.frames}
    return altered(scene, thermal=images, radiometry=CAMERA), rgb, truth


@lru_cache(maxsize=1)
def fitted() -> ThermalModel:
    scene, rgb, _ = mixed()
    return fit_thermal(scene, rgb, SFM_PER_METRE)


def test_the_range_is_its_own_inverse_and_mixes_signals() -> None:
    span = PlanckRange.of(CALIBRATION, HOT)
    temperature = np.linspace(-20.0, 150.0, 50)
    np.testing.assert_allclose(span.expand(span.normalise(temperature)), temperature, atol=1e-3)
    np.testing.assert_allclose(span.normalise(np.array([15.0, 120.0])), [0.0, 1.0], atol=1e-6)
    assert span.lo == pytest.approx(15.0) and span.hi == pytest.approx(120.0)
    half = float(span.expand(np.array(0.5)))
    signals = CAMERA.counts(np.array([15.0, 120.0]))  # emissivity, air and window are affine in the black body's signal
    assert half == pytest.approx(float(CAMERA.celsius(np.array(signals.mean()))), abs=1e-3) and half > 75.0
    wider = extended(span, -0.25)
    assert isinstance(wider, PlanckRange)
    np.testing.assert_allclose(wider.expand(0.8 * span.normalise(temperature) + 0.2), temperature, atol=1e-3)


def test_mixed_pixels_are_right_in_radiance_and_wrong_in_celsius() -> None:
    scene, rgb, _ = mixed()
    model = fitted()
    assert isinstance(model.color_range, PlanckRange)
    in_celsius = fit_thermal(altered(scene, radiometry=CELSIUS), rgb, SFM_PER_METRE)
    right, wrong = held_out_error_c(scene, model), held_out_error_c(scene, in_celsius)
    assert right < 0.2 and wrong > 2.0 * right


def test_another_emissivity_needs_no_other_fit() -> None:
    """Re-evaluating the render is what a fit to re-evaluated photographs shows."""
    scene, rgb, _ = mixed()
    other = replace(CAMERA, parameters=replace(CAMERA.parameters, emissivity=0.7, reflected_c=-10.0))
    changed = {f.name: CAMERA.reevaluated(f.thermal, emissivity=0.7, reflected_c=-10.0) for f in scene.frames}
    again = fit_thermal(altered(scene, thermal=changed, radiometry=other), rgb, SFM_PER_METRE)
    pose = scene.thermal_from_world("000", SFM_PER_METRE)
    before, after = fitted().render(RIG.thermal, pose), again.render(RIG.thermal, pose)
    assert np.abs(after - before).mean() > 5.0
    np.testing.assert_allclose(CAMERA.reevaluated(before, emissivity=0.7, reflected_c=-10.0), after, atol=0.1)


def test_temperatures_of_gaussians_are_in_celsius() -> None:
    scene, _, truth = mixed()
    found = gaussian_temperatures(scene, fitted(), settings=CertaintySettings(calibrate=False))
    colors = truth.color_range.expand((0.5 + truth.gaussians.sh[:, 0, 0].numpy() * 0.28209479177387814).clip(0))
    seen = found.views >= 14
    assert np.median(np.abs(found.temperature - colors)[seen]) < 0.5
    assert (found.std > 0).all() and np.median(found.std[seen]) < 1.0


def test_drift_is_told_in_the_signal() -> None:
    scene, rgb, _ = mixed()
    offsets = {f.name: 40.0 * np.sin(2.0 * i) for i, f in enumerate(scene.capture.frames)}
    signal = {f.name: CALIBRATION.blackbody_signal(f.thermal) + offsets[f.name] for f in scene.capture.frames}
    moved = {name: CALIBRATION.blackbody_celsius(s).astype(np.float32) for name, s in signal.items()}
    model = fit_thermal(altered(scene, thermal=moved), rgb, SFM_PER_METRE, ThermalConfig(drift="offset"))
    found = np.array([model.sensor.drift[f.name][1] for f in scene.train_frames])
    true = np.array([offsets[f.name] for f in scene.train_frames])
    np.testing.assert_allclose(found - np.median(found), true - np.median(true), atol=4.0)


def test_the_paper_s_solver_too() -> None:
    scene, rgb, _ = mixed()
    model = fit_thermal(scene, rgb, SFM_PER_METRE, ThermalConfig(solver="adam", steps=100, learning_rate=5e-2))
    assert isinstance(model.color_range, PlanckRange) and held_out_error_c(scene, model) < 4.0


def test_a_run_keeps_the_constants(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    model = replace(fitted(), temperatures=None)
    folder.write_thermal(model, Sim3.identity())
    again = folder.read_thermal()
    assert again.color_range == model.color_range and again.range == model.range
    data = folder.read_json("thermal.json")
    del data["drift"]
    folder.write_json("thermal.json", data)
    with pytest.raises(RtgsError, match=r"thermal\.json.*drift.*another version.*Remove it and run again"):
        folder.read_thermal()


@pytest.mark.thorough
@pytest.mark.parametrize(
    "radiometry", [CENTIKELVIN, CountsToCelsius(0.04, -100.0), CAMERA], ids=["centikelvin", "linear", "planck"]
)
def test_celsius_to_16_bit_capture_to_model_and_back(radiometry: CountsToCelsius | PlanckRadiometry, tmp_path: Path) -> None:
    """°C → rounded counts on disk → capture → model → render at training views: no bias. Pixels mix as the capture says they do."""
    scene, rgb, _ = mixed() if isinstance(radiometry, PlanckRadiometry) else ring()
    for name in ("rgb", "thermal"):
        (tmp_path / name).mkdir()
    write_rig(tmp_path / "rig.json", RIG, radiometry)
    for f in scene.capture.frames:
        Image.fromarray(np.zeros((RIG.rgb.height, RIG.rgb.width, 3), np.uint8)).save(tmp_path / "rgb" / f"{f.name}.png")
        counts = np.rint(radiometry.counts(f.thermal))
        assert counts.min() >= 0 and counts.max() < 2**16
        Image.fromarray(counts.astype(np.uint16)).save(tmp_path / "thermal" / f"{f.name}.png")
    capture = load_capture(tmp_path)
    assert capture.radiometry == radiometry
    loaded = replace(scene, capture=capture)
    assert isinstance(color_range(loaded), PlanckRange) == isinstance(radiometry, PlanckRadiometry)
    model = fit_thermal(loaded, rgb, SFM_PER_METRE)
    bias = []
    for f in scene.train_frames:  # against what was written down before it was rounded
        shown = model.render(RIG.thermal, scene.thermal_from_world(f.name, SFM_PER_METRE))
        bias.append(float((shown - f.thermal).mean()))
    assert abs(np.mean(bias)) < 0.05 and max(abs(b) for b in bias) < 0.3


def test_masked_and_impossible_values_stay_finite() -> None:
    """Colour 0 may lie below any temperature: it reads as absolute zero, and nothing becomes NaN."""
    span = PlanckRange.of(CALIBRATION, LinearRange(-60.0, 20.0))
    deep = extended(span, -3.0)
    assert deep.lo == pytest.approx(-273.15) and np.isfinite(deep.expand(torch.zeros(3).numpy())).all()
