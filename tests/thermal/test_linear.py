"""The linear thermal fit: what it recovers, and what must not change it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numba as nb
import numpy as np
import pytest
import torch
from tests.helpers.scene_record import altered
from tests.helpers.thermal_scenes import (
    RIG,
    SFM_PER_METRE,
    changed,
    error_of_differences_c,
    fit_of,
    fitted_ring,
    held_out_error_c,
    model_of,
    outliers,
    ring,
)

from rtgs.config import ThermalConfig
from rtgs.maths.sh import C0, basis
from rtgs.records.radiometry import LinearRange
from rtgs.thermal import fit_thermal, gaussian_temperatures, training_range
from rtgs.thermal.least_squares import solve
from rtgs.thermal.linear import fit_linear
from rtgs.thermal.settings import LinearSettings


def test_the_default_fit_finds_known_temperatures() -> None:
    scene, _, _ = ring()
    assert held_out_error_c(scene, fitted_ring()) < 0.05  # of 30 °C; what is left is the ridge
    model = fitted_ring()
    assert float(model.color_range.expand(model.background.numpy())[0]) == pytest.approx(20.0, abs=0.02)
    assert len(model.history["step"]) == len(model.history["loss"]) > 1 and model.history["loss"][-1] < 3e-3


def test_geometry_and_opacity_stay_bit_for_bit() -> None:
    _, rgb, _ = ring()
    model = fitted_ring()
    for name in ("means", "quats", "log_scales", "opacity_logits"):
        assert torch.equal(model.gaussians.tensors()[name], rgb.gaussians.tensors()[name]), name
    assert model.gaussians.sh.shape == (len(rgb.gaussians), 4, 1) and model.background.shape == (1,)
    assert model.range == training_range(ring()[0]) and model.sfm_per_metre == SFM_PER_METRE


def test_temperature_scale_does_not_matter() -> None:
    scene, rgb, _ = ring()
    counts = fit_thermal(changed(scene, lambda _, t: 100 * t + 27315), rgb, SFM_PER_METRE, ThermalConfig(drift="off"))
    pose = scene.thermal_from_world("000", SFM_PER_METRE)
    a, b = fitted_ring().render(RIG.thermal, pose), counts.render(RIG.thermal, pose)
    np.testing.assert_allclose((b - 27315) / 100, a, atol=0.01)


@pytest.mark.thorough
def test_held_out_frames_change_nothing() -> None:
    scene, rgb, _ = ring()
    rng = np.random.default_rng(0)
    noise = {f.name: rng.uniform(-100, 900, f.thermal.shape).astype(np.float32) for f in scene.held_out_frames}
    a, b = (fit_thermal(s, rgb, SFM_PER_METRE) for s in (scene, altered(scene, thermal=noise)))
    assert torch.equal(a.gaussians.sh, b.gaussians.sh) and torch.equal(a.background, b.background)
    assert a.range == b.range and a.history == b.history and a.sensor.drift == b.sensor.drift


@pytest.mark.thorough
def test_masked_pixels_change_nothing() -> None:
    scene, rgb, _ = ring()
    mask = np.ones((RIG.thermal.height, RIG.thermal.width), bool)
    mask[:, :4], mask[25:] = False, False
    models, sure = [], []
    for junk in (0.0, 400.0, math.nan):
        masked = altered(changed(scene, lambda _, t: np.where(mask, t, junk)), thermal_mask=mask)  # noqa: B023
        models.append(fit_thermal(masked, rgb, SFM_PER_METRE))
        sure.append(gaussian_temperatures(masked, models[-1]))
    for other, temperatures in zip(models[1:], sure[1:], strict=True):
        assert torch.equal(models[0].gaussians.sh, other.gaussians.sh)
        np.testing.assert_array_equal(sure[0].std, temperatures.std)
    assert torch.isfinite(models[0].gaussians.sh).all() and np.isfinite(sure[0].std).all()
    assert held_out_error_c(scene, models[0]) < 0.1


def test_temperatures_below_the_range_survive() -> None:
    """A cold spot that the 0.1 percentile leaves out: its colours are below the range, and nothing clamps them."""
    scene, rgb, truth = ring()
    cold = truth.gaussians.sh.clone()
    cold[7] = (-2.0 - 0.5) / C0  # −45 °C, through a renderer whose colour 0 is at −165 °C
    wide = replace(
        truth, gaussians=replace(truth.gaussians, sh=(0.5 + C0 * cold + 5.0) / 6.0 / C0 - 0.5 / C0),
        background=(truth.background + 5.0) / 6.0, color_range=LinearRange(15.0 - 150.0, 45.0),
    )  # fmt: skip
    images = {f.name: wide.render(RIG.thermal, scene.thermal_from_world(f.name, SFM_PER_METRE)) for f in scene.frames}
    scene = altered(scene, thermal=images)
    lowest = min(float(i.min()) for i in images.values())
    model = fit_thermal(scene, rgb, SFM_PER_METRE, ThermalConfig(drift="off"))
    assert lowest < model.range.lo - 10.0  # there is something below the range to be lost
    assert held_out_error_c(scene, model) < 0.05
    directions = torch.nn.functional.normalize(torch.randn(4000, 3, generator=torch.Generator().manual_seed(3)), dim=1)
    colors = 0.5 + torch.einsum("dk,nk->nd", basis(directions, 1), model.gaussians.sh[..., 0])
    assert float(colors.min()) > 0.0 and model.color_range.lo < lowest and model.color_range.hi == model.range.hi
    deepest = min(
        float(model.render(RIG.thermal, scene.thermal_from_world(f.name, SFM_PER_METRE)).min()) for f in scene.train_frames
    )
    assert deepest == pytest.approx(min(float(f.thermal.min()) for f in scene.train_frames), abs=0.5)


def test_a_few_wrong_pixels_do_little() -> None:
    scene, rgb, _ = ring()
    rng = np.random.default_rng(2)
    dirty = changed(scene, lambda i, t: t if i % 8 == 0 else np.where(rng.random(t.shape) < 0.01, t + 60.0, t))
    assert held_out_error_c(scene, fit_thermal(dirty, rgb, SFM_PER_METRE)) < 0.3  # 0.6 °C on average in the images


@pytest.mark.parametrize("stop", [0.02, 0.3])
def test_progress_is_shown_and_can_stop_the_fit(stop: float) -> None:
    scene, rgb, _ = ring()
    shares: list[float] = []

    def progress(done: int, total: int, text: str) -> None:
        shares.append(done / total)
        if shares[-1] > stop:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_thermal(scene, rgb, SFM_PER_METRE, progress=progress)
    assert shares == sorted(shares) and all(0 < share < 1 for share in shares)
    texts: list[str] = []
    fit_thermal(scene, rgb, SFM_PER_METRE, progress=lambda done, total, text: texts.append(f"{done / total:g} {text}"))
    assert texts[-1].startswith("1 residual 0.0")


@pytest.mark.parametrize("drift", ["auto", "offset", "gain-offset"])
@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_few_frames(count: int, drift: Literal["auto", "offset", "gain-offset"]) -> None:
    scene, rgb, _ = ring()
    kept = [f.name for f in scene.train_frames][:count]
    some = replace(scene, world_from_rgb={n: scene.world_from_rgb[n] for n in kept})
    model = fit_thermal(some, rgb, SFM_PER_METRE, ThermalConfig(drift=drift))
    assert torch.isfinite(model.gaussians.sh).all() and bool(model.sensor.drift) == (drift != "auto")
    for frame in some.train_frames:
        shown = model.render(RIG.thermal, some.thermal_from_world(frame.name, SFM_PER_METRE), photographed_in=frame.name)
        assert np.abs(shown - frame.thermal).mean() < 0.3  # of 30 °C


def test_eight_noisy_frames_get_a_ridge_that_suits_them() -> None:
    """One validation frame, which says both which ridge and when it is enough. A usual ridge is as good a bound as any."""
    rng, (scene, rgb, _) = np.random.default_rng(1), ring()
    noisy = changed(scene, lambda _, t: t + 0.05 * rng.standard_normal(t.shape))
    kept = [f.name for f in noisy.train_frames][:8]
    some = replace(noisy, world_from_rgb={n: noisy.world_from_rgb[n] for n in kept})
    model = fit_thermal(some, rgb, SFM_PER_METRE)
    fit = fit_of(some, rgb)
    problem = fit.problem((fit.settings.default_factor,), range(len(fit.data)))
    x = solve(problem, problem.prior, iterations=30).x
    usual = model_of(fit, x, some, rgb)
    assert error_of_differences_c(model, scene) < 1.2 * error_of_differences_c(usual, scene) < 0.5


@pytest.mark.thorough
def test_same_twice() -> None:
    scene, rgb, _ = ring()
    a, b = (fit_thermal(scene, rgb, SFM_PER_METRE) for _ in range(2))
    assert torch.equal(a.gaussians.sh, b.gaussians.sh) and torch.equal(a.background, b.background)


@pytest.mark.thorough
@pytest.mark.parametrize("kept_bytes", [2 << 30, 1_200_000, 300_000])
def test_threads_change_nothing(kept_bytes: int) -> None:
    """Nor where seven of 28 views have their weights kept and the others their lists, or half of them nothing."""
    scene, rgb, _ = ring()
    one, three = (
        fit_linear(outliers(scene), rgb, SFM_PER_METRE, ThermalConfig(), settings=settings)
        for settings in (LinearSettings(kept_bytes=kept_bytes, threads=threads) for threads in (1, 3))
    )
    assert torch.equal(one.gaussians.sh, three.gaussians.sh) and one.sensor.drift == three.sensor.drift


def test_small_images_get_one_thread() -> None:
    """And PyTorch has one while a fit runs; afterwards everything is as it was."""
    many = nb.get_num_threads()
    assert LinearSettings(small_image_px=1081).threads_for(1080) == 1
    assert LinearSettings(small_image_px=1080).threads_for(1080) == many
    assert LinearSettings(threads=3).threads_for(1080) == 3
    seen: set[tuple[int, int]] = set()
    before = torch.get_num_threads()

    def progress(done: int, total: int, text: str) -> None:
        seen.add((nb.get_num_threads(), torch.get_num_threads()))

    scene, rgb, _ = ring()
    gaussian_temperatures(scene, fit_thermal(scene, rgb, SFM_PER_METRE, progress=progress), progress=progress)
    assert seen == {(1, 1)} and (nb.get_num_threads(), torch.get_num_threads()) == (many, before)


@pytest.mark.thorough
@pytest.mark.parametrize("drift", ["offset", "auto"])
def test_one_row_of_several_leads_to_the_same(drift: Literal["offset", "auto"]) -> None:
    """Where there are many photographs: what some rows say leads where all of them lead; drift and vignetting go with it."""
    scene, rgb, _ = ring()
    vignetting = 1.5 * np.linspace(-1, 1, RIG.thermal.width) ** 2 + np.zeros((RIG.thermal.height, 1))
    capture = changed(scene, lambda i, t: t + vignetting + 0.8 * math.sin(0.4 * i))
    errors = []
    for settings, rows in ((LinearSettings(), "all"), (LinearSettings(pixels=28 * vignetting.size // 3), "1 in 3")):
        model = fit_linear(capture, rgb, SFM_PER_METRE, ThermalConfig(drift=drift), settings=settings)
        assert model.decisions[0].name == "rows" and model.decisions[0].choice == rows
        assert model.sensor.drift and model.sensor.pattern is not None and model.sensor.pattern.shape == vignetting.shape
        assert (model.sensor.pattern - vignetting).std() < 0.1 * vignetting.std()
        errors.append(error_of_differences_c(model, scene))
    assert errors[1] < 2.5 * errors[0] and errors[1] < 0.1
