"""The linear thermal fit tells the sensor's drift and pattern from the scene."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.helpers.thermal_scenes import RIG, SFM_PER_METRE, changed, error_of_differences_c, ring

from rtgs.config import ThermalConfig
from rtgs.records.scene import Scene
from rtgs.thermal import fit_thermal
from rtgs.thermal.linear import fit_linear
from rtgs.thermal.settings import LinearSettings


def drifting(gains: bool) -> tuple[Scene, np.ndarray, np.ndarray]:
    """The known scene at 50 mK of noise, with offsets up to 1 °C and contrast up to 5 % about 22 °C."""
    rng = np.random.default_rng(4)
    offset, gain = rng.uniform(-1, 1, 32), 1 + 0.05 * gains * rng.uniform(-1, 1, 32)
    scene = changed(ring()[0], lambda i, t: 22 + offset[i] + gain[i] * (t - 22) + 0.05 * rng.standard_normal(t.shape))
    return scene, gain, offset


@pytest.mark.parametrize("gains", [False, True])
def test_drift_is_found_again(gains: bool) -> None:
    scene, gain, offset = drifting(gains)
    rgb = ring()[1]
    model = fit_thermal(scene, rgb, SFM_PER_METRE)
    names = [f.name for f in scene.train_frames]
    assert list(model.sensor.drift) == names
    found = np.array([model.sensor.drift[n] for n in names])
    train = [int(n) for n in names]
    at_22 = (found[:, 0] - 1) * 22 + found[:, 1]  # photograph less image where the image is 22 °C
    np.testing.assert_allclose(at_22 - np.median(at_22), offset[train] - np.median(offset[train]), atol=0.1)
    if gains:
        np.testing.assert_allclose(found[:, 0] / np.median(found[:, 0]), gain[train] / np.median(gain[train]), atol=0.015)
        assert np.median(np.log(found[:, 0])) == pytest.approx(0.0, abs=0.01)
    # Up to the gauge the model is that of the scene without drift; ignoring drift costs several times as much.
    without = error_of_differences_c(fit_thermal(scene, rgb, SFM_PER_METRE, ThermalConfig(drift="off")), ring()[0])
    assert error_of_differences_c(model, ring()[0]) < min(0.05, 0.2 * without)


def test_gains_are_found_where_offsets_alone_explain_nothing() -> None:
    """An automatic gain control that stretches contrast about the middle of the scene: offsets do not help, gains do."""
    rng = np.random.default_rng(5)
    gain, middle = rng.uniform(0.85, 1.15, 32), float(np.median(ring()[0].train_frames[0].thermal))
    scene = changed(ring()[0], lambda i, t: middle + gain[i] * (t - middle) + 0.05 * rng.standard_normal(t.shape))
    model = fit_thermal(scene, ring()[1], SFM_PER_METRE)
    names = [f.name for f in scene.train_frames]
    found, true = np.array([model.sensor.drift[n][0] for n in names]), gain[[int(n) for n in names]]
    np.testing.assert_allclose(found / np.median(found), true / np.median(true), atol=0.04)  # of gains 0.3 apart
    without = error_of_differences_c(fit_thermal(scene, ring()[1], SFM_PER_METRE, ThermalConfig(drift="off")), ring()[0])
    assert error_of_differences_c(model, ring()[0]) < 0.5 * without


def test_without_drift_none_is_modelled() -> None:
    rng = np.random.default_rng(6)
    noisy = changed(ring()[0], lambda _, t: t + 0.05 * rng.standard_normal(t.shape))
    model = fit_thermal(noisy, ring()[1], SFM_PER_METRE)
    assert model.sensor.drift == {} and model.sensor.pattern is None


def striped(drift_c: float) -> tuple[Scene, np.ndarray]:
    """The known scene at 50 mK of noise, seen by a sensor with readout stripes and vignetting, and offsets up to `drift_c`."""
    rng, (h, w) = np.random.default_rng(8), (RIG.thermal.height, RIG.thermal.width)
    y, x = np.linspace(-1, 1, h)[:, None], np.linspace(-1, 1, w)[None]
    pattern = 0.15 * rng.standard_normal((h, 1)) + 0.15 * rng.standard_normal((1, w)) + 0.6 * (2 / 3 - x**2 - y**2)
    offset = rng.uniform(-drift_c, drift_c, 32)
    scene = changed(ring()[0], lambda i, t: t + pattern + offset[i] + 0.05 * rng.standard_normal(t.shape))
    return scene, pattern


@pytest.mark.parametrize("drift_c", [0.0, 1.0])
def test_a_sensors_pattern_is_told_from_the_scene(drift_c: float) -> None:
    (scene, pattern), rgb = striped(drift_c), ring()[1]
    model = fit_thermal(scene, rgb, SFM_PER_METRE)
    assert model.sensor.pattern is not None and model.sensor.pattern.dtype == np.float32
    assert bool(model.sensor.drift) == (drift_c > 0)
    assert (model.sensor.pattern - pattern).std() < 0.3 * pattern.std()
    never = LinearSettings(pattern_gain=math.inf)
    ignored = fit_linear(scene, rgb, SFM_PER_METRE, ThermalConfig(), settings=never)
    assert ignored.sensor.pattern is None
    photographs, truths = [], []
    for m in (model, ignored):
        errors = []
        for frame, clean in zip(scene.held_out_frames, ring()[0].held_out_frames, strict=True):
            pose = scene.thermal_from_world(frame.name, SFM_PER_METRE)
            away = (
                m.render(RIG.thermal, pose, photographed_in=frame.name) - frame.thermal,
                m.render(RIG.thermal, pose) - clean.thermal,
            )
            errors.append([np.abs(e - np.median(e)).mean() for e in away])
        photograph, truth = np.mean(errors, axis=0)
        photographs.append(photograph)
        truths.append(truth)
    assert photographs[0] < 0.6 * photographs[1] and truths[0] < 0.6 * truths[1]
