"""The paper's thermal fit: frozen geometry, known temperatures found again, nothing learnt from held-out frames."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from tests.helpers.scene_record import altered
from tests.helpers.thermal_scenes import RIG, SFM_PER_METRE, held_out_error_c, known

from rtgs.base.errors import RtgsError
from rtgs.config import ThermalConfig
from rtgs.evaluation.held_out import evaluate
from rtgs.maths.sh import C0
from rtgs.models import ThermalModel
from rtgs.records.radiometry import RelativeCounts
from rtgs.thermal import fit_thermal, training_range

QUICK = ThermalConfig(solver="adam", steps=20)


@lru_cache(maxsize=4)
def fitted(sfm_per_metre: float = SFM_PER_METRE) -> ThermalModel:
    scene, rgb, _ = known()
    return fit_thermal(scene, rgb, sfm_per_metre, ThermalConfig(solver="adam", steps=400, learning_rate=3e-2))


def test_geometry_and_opacity_stay_bit_for_bit() -> None:
    _, rgb, _ = known()
    before = {k: v.clone() for k, v in rgb.gaussians.tensors().items()}
    model = fitted()
    for name in ("means", "quats", "log_scales", "opacity_logits"):
        assert torch.equal(model.gaussians.tensors()[name], before[name]), name
        assert torch.equal(rgb.gaussians.tensors()[name], before[name]), name
    assert torch.equal(rgb.gaussians.sh, before["sh"])  # the RGB model is not recoloured
    assert model.gaussians.sh.shape == (len(rgb.gaussians), 4, 1) and model.background.shape == (1,)
    assert not any(t.requires_grad for t in model.gaussians.tensors().values())
    assert model.settings == rgb.settings and model.sfm_per_metre == SFM_PER_METRE


def test_known_temperatures_are_found_again() -> None:
    scene, _, truth = known()
    model = fitted()
    assert held_out_error_c(scene, model) < 0.25  # of 30 °C
    background_c = float(model.range.expand(model.background.numpy())[0])
    assert background_c == pytest.approx(20.0, abs=0.2)
    # Each Gaussian that is seen, not only the picture: the view-independent part as a temperature.
    celsius = [m.range.expand(0.5 + C0 * m.gaussians.sh[:, 0, 0].numpy()) for m in (model, truth)]
    assert np.median(np.abs(celsius[0] - celsius[1])) < 2.0
    assert model.history["loss"][-1] < 0.1 * model.history["loss"][0]
    assert len(model.history["step"]) == len(model.history["loss"]) == 20 and model.history["step"][-1] == 400


@pytest.mark.thorough
def test_a_wrong_scale_fits_worse() -> None:
    scene, _, _ = known()
    right, wrong = (held_out_error_c(scene, fitted(s)) for s in (SFM_PER_METRE, 1.5 * SFM_PER_METRE))
    assert wrong > 3 * right
    assert fitted(1.5 * SFM_PER_METRE).history["loss"][-1] > 3 * fitted().history["loss"][-1]


def test_range_is_the_percentiles_of_training_frames() -> None:
    scene, _, _ = known()
    values = np.concatenate([f.thermal.ravel() for i, f in enumerate(scene.capture.frames) if i not in (0, 8)])
    span = training_range(scene)
    np.testing.assert_allclose([span.lo, span.hi], np.percentile(values, [0.1, 99.9]))
    flat = altered(scene, thermal={f.name: np.full_like(f.thermal, 21.0) for f in scene.frames})
    assert (training_range(flat).lo, training_range(flat).hi) == (21.0, 22.0)  # never empty


def test_range_is_of_valid_pixels() -> None:
    scene, _, _ = known()
    mask = np.ones((RIG.thermal.height, RIG.thermal.width), bool)
    mask[:, :4] = False
    hot = {f.name: np.where(mask, f.thermal, np.float32(500.0)) for f in scene.frames}
    assert training_range(altered(scene, thermal=hot, thermal_mask=mask)).hi < 46


def test_held_out_frames_change_nothing() -> None:
    scene, rgb, _ = known()
    rng = np.random.default_rng(0)
    noise = {f.name: rng.uniform(-100, 900, f.thermal.shape).astype(np.float32) for f in scene.held_out_frames}
    assert list(noise) == ["000", "008"]
    a, b = (fit_thermal(s, rgb, SFM_PER_METRE, QUICK) for s in (scene, altered(scene, thermal=noise)))
    assert a.range == b.range and torch.equal(a.gaussians.sh, b.gaussians.sh) and torch.equal(a.background, b.background)
    assert a.history == b.history


@pytest.mark.parametrize("ssim_weight", [0.0, 0.3])
def test_masked_pixels_change_nothing(ssim_weight: float) -> None:
    scene, rgb, _ = known()
    mask = np.ones((RIG.thermal.height, RIG.thermal.width), bool)
    mask[:, :4], mask[25:] = False, False
    config = replace(QUICK, ssim_weight=ssim_weight)
    models = []
    for junk in (0.0, 400.0, math.nan):
        images = {f.name: np.where(mask, f.thermal, np.float32(junk)) for f in scene.frames}
        models.append(fit_thermal(altered(scene, thermal=images, thermal_mask=mask), rgb, SFM_PER_METRE, config))
    for other in models[1:]:
        assert torch.equal(models[0].gaussians.sh, other.gaussians.sh)
    assert torch.isfinite(models[0].gaussians.sh).all()


def test_ssim_weight_has_a_say() -> None:
    scene, rgb, _ = known()
    plain, with_ssim = (fit_thermal(scene, rgb, SFM_PER_METRE, replace(QUICK, ssim_weight=w)) for w in (0.0, 0.5))
    assert not torch.equal(plain.gaussians.sh, with_ssim.gaussians.sh)
    assert np.isfinite(with_ssim.history["loss"]).all() and with_ssim.history["loss"][-1] < with_ssim.history["loss"][0]


def test_noise_start_is_seeded() -> None:
    scene, rgb, _ = known()
    noisy = ThermalConfig(solver="adam", steps=0, initial_noise=0.3)
    a, b, c = (fit_thermal(scene, rgb, SFM_PER_METRE, replace(noisy, seed=s)).gaussians.sh for s in (5, 5, 6))
    assert torch.equal(a, b) and not torch.equal(a, c)
    assert a.std() == pytest.approx(0.3, rel=0.1) and a.mean() == pytest.approx(0.0, abs=0.05)
    clean = fit_thermal(scene, rgb, SFM_PER_METRE, ThermalConfig(solver="adam", steps=0))
    assert (clean.gaussians.sh == 0).all()  # the middle of the range


def test_same_seed_same_model() -> None:
    scene, rgb, _ = known()
    a, b, c = (fit_thermal(scene, rgb, SFM_PER_METRE, replace(QUICK, seed=s)) for s in (0, 0, 1))
    assert torch.equal(a.gaussians.sh, b.gaussians.sh)
    assert not torch.equal(a.gaussians.sh, c.gaussians.sh)  # another order of frames


def test_temperature_scale_does_not_matter() -> None:
    """Kelvins, degrees or counts: the fit is in units of the range."""
    scene, rgb, _ = known()
    counts = {f.name: (100 * f.thermal + 27315).astype(np.float32) for f in scene.frames}
    a, b = (fit_thermal(s, rgb, SFM_PER_METRE, QUICK) for s in (scene, altered(scene, thermal=counts)))
    torch.testing.assert_close(a.gaussians.sh, b.gaussians.sh, atol=5e-3, rtol=0)
    assert b.range.hi - b.range.lo == pytest.approx(100 * (a.range.hi - a.range.lo), rel=1e-4)


def test_relative_captures_say_counts() -> None:
    scene, rgb, _ = known()
    scene = altered(scene, radiometry=RelativeCounts())
    scores = evaluate(scene, replace(rgb, gaussians=rgb.gaussians), fit_thermal(scene, rgb, SFM_PER_METRE, QUICK))
    assert scores.thermal.known()["mae_counts"] > 0 and scores.count_range is not None
    assert scores.thermal.mae_c is None and scores.temperature_range_c is None


def test_progress_is_shown_and_can_stop_the_fit() -> None:
    scene, rgb, _ = known()
    shares: list[float] = []

    def progress(done: int, total: int, text: str) -> None:
        shares.append(done / total)
        assert "loss" in text
        if shares[-1] >= 0.25:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_thermal(scene, rgb, SFM_PER_METRE, QUICK, progress=progress)
    assert shares == sorted(shares) and shares[0] > 0 and shares[-1] == 0.25


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_a_bad_scale_is_refused(bad: float) -> None:
    scene, rgb, _ = known()
    with pytest.raises(RtgsError, match="sfm_per_metre"):
        fit_thermal(scene, rgb, bad, QUICK)


def test_without_training_frames() -> None:
    scene, rgb, _ = known()
    held_out = {f.name: scene.world_from_rgb[f.name] for f in scene.held_out_frames}
    with pytest.raises(RtgsError, match="no training frame"):
        fit_thermal(replace(scene, world_from_rgb=held_out), rgb, SFM_PER_METRE, QUICK)
