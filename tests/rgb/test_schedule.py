"""Learning rates, bands and image sizes in the course of training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from tests.helpers.ball_scene import QUICK, synthetic

from rtgs.rgb.schedule import MOST_PACE, RATES_STEPS, SETTLE_TO, learning_rates, reduction
from rtgs.rgb.train import Training


def test_the_position_rate_falls_a_hundredfold_and_goes_with_the_extent() -> None:
    scene = synthetic()
    training = Training(scene, replace(QUICK, steps=10))
    rates = []
    for _ in range(10):
        training.advance()
        rate = training.optimizer.rates["means"]
        assert isinstance(rate, float)
        rates.append(rate)
    np.testing.assert_allclose(rates, MOST_PACE * 1.6e-4 * scene.steady().extent * 0.01 ** (np.arange(10) / 10))


def test_all_rates_settle_at_the_end() -> None:
    rates = []
    for step in range(101):
        now = learning_rates(step, 100, 1.0, 1)
        rates.append([float(torch.as_tensor(now[k]).flatten()[-1]) for k in ("quats", "log_scales", "opacity_logits", "sh")])
    falling = np.array(rates) / rates[0]
    np.testing.assert_allclose(falling[:71], 1.0)
    np.testing.assert_allclose(falling[-1], SETTLE_TO, rtol=1e-5)
    assert (np.diff(falling[70:], axis=0) < 0).all()


def test_fewer_steps_are_larger_ones_up_to_a_limit() -> None:
    def first_rates(steps: int) -> dict[str, float]:
        training = Training(synthetic(), replace(QUICK, steps=steps))
        training.advance()
        return {name: float(torch.as_tensor(rate).flatten()[0]) for name, rate in training.optimizer.rates.items()}

    few, many, long, longer = (first_rates(steps) for steps in (50, RATES_STEPS // 4, RATES_STEPS, 10 * RATES_STEPS))
    assert long == longer == pytest.approx({**long, "log_scales": 5e-3, "opacity_logits": 5e-2, "quats": 1e-3, "sh": 2.5e-3})
    for name, rate in long.items():
        assert many[name] == pytest.approx(2 * rate) and few[name] == pytest.approx(MOST_PACE * rate), name


def test_coarse_levels_come_first_and_stop_at_48_pixels() -> None:
    levels = ((0.2, 4), (0.55, 2))
    assert [reduction(levels, step, 100, 192) for step in (0, 19, 20, 54, 56, 99)] == [4, 4, 2, 2, 1, 1]
    assert [reduction(levels, step, 100, 191) for step in (0, 20, 56)] == [2, 2, 1]  # a quarter of it is too small
    assert reduction(levels, 0, 100, 40) == 1
