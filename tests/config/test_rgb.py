"""Settings of the RGB model's training."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.helpers.ball_scene import QUICK, synthetic

from rtgs.base.errors import RtgsError
from rtgs.config import QUALITIES, DensifyConfig, RgbConfig
from rtgs.rgb.train import fit_rgb


def test_a_quality_fills_in_what_is_left_open_and_nothing_else() -> None:
    plans = [RgbConfig(quality=quality).resolved() for quality in QUALITIES]
    steps = [plan.steps for plan in plans if plan.steps is not None]
    assert (
        len(steps) == len(plans)
        and steps == sorted(set(steps))
        and all(plan.densify.pixels_each and plan.sh_degree for plan in plans)
    )
    assert RgbConfig().resolved() == RgbConfig(quality="default").resolved() == plans[1]
    given = RgbConfig(quality="fast", steps=7, sh_degree=0, densify=DensifyConfig(max_gaussians=9, pixels_each=3.0))
    assert given.resolved() == given
    partly = RgbConfig(quality="best", steps=7).resolved()
    assert partly.steps == 7 and partly.densify == plans[2].densify
    model = fit_rgb(synthetic(), replace(QUICK, quality="fast", steps=3))
    assert model.history["step"][-1] == 3


def test_a_quality_or_a_number_of_steps_that_cannot_be_is_refused() -> None:
    with pytest.raises(RtgsError, match=r"rgb\.quality is 'good'; it is fast, default, best"):
        RgbConfig(quality="good")  # type: ignore[arg-type]
    with pytest.raises(RtgsError, match=r"rgb\.steps is 0"):
        RgbConfig(steps=0)


def test_a_back_end_that_does_not_exist_is_refused() -> None:
    with pytest.raises(RtgsError, match=r"rgb\.backend is 'gpu'; it is cpu, cuda or reference"):
        RgbConfig(backend="gpu")  # type: ignore[arg-type]
