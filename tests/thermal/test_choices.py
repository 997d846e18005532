"""What the fit decides by itself, and what it says about it."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.helpers.thermal_scenes import SFM_PER_METRE, changed, fit_of, ring

from rtgs.base.memory import Memory
from rtgs.config import DriftKind
from rtgs.thermal import fit_thermal, training_range
from rtgs.thermal.candidates import first_solve
from rtgs.thermal.choices import choose_drift, choose_gains, choose_pattern, choose_ridge, choose_rows
from rtgs.thermal.fit import Fitted
from rtgs.thermal.frames import ThermalFrames
from rtgs.thermal.settings import LinearSettings
from rtgs.thermal.validation import Validation


def photographs(count: int, valid: torch.Tensor) -> ThermalFrames:
    return ThermalFrames(("",) * count, (valid,) * count, valid, ())


def test_how_many_rows_are_used() -> None:
    settings, valid = LinearSettings(memory_bytes=1 << 50), torch.ones(512, 640)
    assert choose_rows(photographs(12, valid[:120, :160]), settings)[0] == 1
    every, decision = choose_rows(photographs(35, valid), settings)
    assert every == 4 and decision.choice == "1 in 4" and "11,468,800" in decision.reason
    assert choose_rows(photographs(5000, valid), settings)[0] == settings.most_rows
    valid[settings.most_rows // 2 :: settings.most_rows] = 0.0  # a mask that leaves none of these
    assert choose_rows(photographs(5000, valid), settings)[0] == 1


def test_rows_that_do_not_fit_into_memory_are_not_used() -> None:
    """What is kept of the photographs takes its share of the memory at most, however many there are. A usual capture loses no row."""
    valid = torch.ones(512, 640)
    for gigabytes, count in ((2.0, 30), (2.0, 300), (4.0, 1000), (4.0, 5000)):
        settings = LinearSettings.within(Memory.of(gigabytes))
        every, decision = choose_rows(photographs(count, valid), settings)
        pixels = count * valid[every // 2 :: every].numel()
        assert settings.bytes_per_pixel * pixels <= 0.85 * settings.memory_bytes  # a part of a row counts as one
        assert settings.weights_bytes(pixels) >= 0.15 * settings.memory_bytes
        assert (every > settings.most_rows) == ("memory" in decision.reason) == (count > 30)
    assert choose_rows(photographs(35, valid), LinearSettings.within(Memory.of(4.0)))[0] == settings.most_rows


def vignetted(settings: LinearSettings) -> Validation:
    """The ball of `ring` with vignetting, without which the error of validation frames is lower by far more than a tenth."""
    scene, rgb, _ = ring()
    bent = changed(scene, lambda i, t: t + 2.0 * np.linspace(-1, 1, t.shape[1]) ** 2)
    return Validation.of(fit_of(bent, rgb, settings=settings))


def test_what_explains_little_is_no_pattern() -> None:
    """Errors of the geometry that stay in the same place look like vignetting, and explain less than is required."""
    validation = vignetted(LinearSettings())
    first = first_solve(validation)
    found, decision = choose_pattern(validation, first)
    assert found and decision.choice == "removed" and decision.threshold == 0.1
    assert decision.error_before is not None and decision.error_after is not None
    gain = 1.0 - decision.error_after / decision.error_before
    assert gain > 0.1
    for required, there in ((0.9 * gain, True), (1.1 * gain, False)):
        demanding = vignetted(LinearSettings(pattern_gain=required))
        again, reason = choose_pattern(demanding, first)
        assert again == there and reason.choice == ("removed" if there else "none")


def test_without_a_pattern_none_is_found() -> None:
    validation = Validation.of(fit_of(ring()[0], ring()[1]))
    found, decision = choose_pattern(validation, first_solve(validation))
    assert not found and decision.choice == "none"


class Preferring(Validation):
    """Validation frames to which one column of those compared is the best."""

    best, asked = 0, 0

    def errors(self, kind: DriftKind, images: object, among: object = None) -> torch.Tensor:
        turn = self.asked % 4
        object.__setattr__(self, "asked", self.asked + 1)
        return torch.tensor([1.0 + (turn != self.best)])


def test_the_ridge_with_the_smallest_error_is_chosen() -> None:
    """And what it leads to is its own: the weaker the ridge, the more view dependence."""
    factors, sizes = (30.0, 3.0, 0.3, 0.01), []
    settings = LinearSettings(
        ridge_factors=factors, stop_share_ridge=-math.inf, iterations=6
    )  # six iterations, whatever the errors
    fit = fit_of(ring()[0], ring()[1], settings=settings)
    start = Fitted.of(fit, fit.coverage.prior[:, None])[0]
    for best in range(4):
        validation = Preferring(fit, [4, 12])
        object.__setattr__(validation, "best", best)
        factor, found, decision = choose_ridge(validation, "off", start)
        assert factor == factors[best] and decision.choice == f"{factor:g}"
        for image, expected in zip(found.images, fit.images(found.x), strict=True):  # of frames that were fitted, and were not
            torch.testing.assert_close(image, expected[..., 0], atol=1e-5, rtol=0)
        sizes.append(float(fit.design.harmonics(found.x)[:, 1:].norm()))
    assert all(1.05 * under_stronger < under_weaker for under_stronger, under_weaker in itertools.pairwise(sizes))


@pytest.mark.parametrize("asked", ["off", "offset", "gain-offset"])
def test_what_the_user_asks_for_is_done_and_said(asked: DriftKind) -> None:
    validation = Validation.of(fit_of(ring()[0], ring()[1]))
    first = first_solve(validation)
    kind, drift = choose_drift(validation, first, asked)
    kind, _, gains = choose_gains(validation, kind, first.under(kind), asked)
    assert kind == asked and drift.choice == ("off" if asked == "off" else "offset")
    assert gains.choice == ("on" if asked == "gain-offset" else "off")
    assert "setting" in drift.reason and asked in drift.reason and asked in gains.reason


@pytest.mark.parametrize("count", [2, 10])
def test_too_few_frames_are_said(count: int) -> None:
    """Without a validation frame, and with one: none of them decides about drift or pattern."""
    scene, rgb, _ = ring()
    kept = [f.name for f in scene.train_frames][:count]
    some = replace(scene, world_from_rgb={n: scene.world_from_rgb[n] for n in kept})
    decisions = {d.name: d for d in fit_thermal(some, rgb, SFM_PER_METRE).decisions}
    assert list(decisions) == ["rows", "drift", "pattern", "gains", "ridge", "geometry"]
    few = ("drift", "pattern", "gains", "ridge", "geometry") if count == 2 else ("drift", "pattern", "gains")
    for name in few:
        assert decisions[name].choice in ("off", "none", "0.3", "frozen") and "too few" in decisions[name].reason


def test_a_decision_has_the_errors_in_degrees() -> None:
    """Of offsets: what is left of ±1 °C is far less than that; and the errors are of the °C that a person would compute."""
    scene, rgb, _ = ring()
    drifting = changed(scene, lambda i, t: t + math.sin(2.0 * i))
    validation = Validation.of(fit_of(drifting, rgb))
    first = first_solve(validation)
    kind, decision = choose_drift(validation, first, "auto")
    assert kind == "offset" and decision.unit == "°C" and decision.threshold == 0.005
    assert decision.error_before is not None and decision.error_after is not None
    assert decision.error_after < 0.8 * decision.error_before
    width = training_range(drifting).width
    by_hand = []
    for f in validation.frames:
        left = (validation.fit.data.images[f] - first.offsets.images[f]).double()
        by_hand.append(float((left - left.mean()).abs().mean()) * width)
    assert decision.error_after == pytest.approx(np.mean(by_hand), rel=0.1)  # the common surface takes part of it
