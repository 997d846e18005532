"""When a scale is called ambiguous or unobservable."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from tests.helpers.scale_scenes import GLOBAL, facing_walls, objective, synthetic

from rtgs.scale import estimate_scale
from rtgs.scale.bracket import Bracket
from rtgs.scale.curves import LocalCurves
from rtgs.scale.interval import Interval, interval_of
from rtgs.scale.misfit import NO_MISFIT, Misfit
from rtgs.scale.objective import FrameLoss
from rtgs.scale.problem import Found
from rtgs.scale.records import History, Minimum
from rtgs.scale.verdict import Verdict, discord_of, outside, verdict_of


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_far_wall_tells_nothing_and_says_so(noise: float) -> None:
    scene, model = facing_walls(400.0, None, noise)  # the baseline moves the picture by 0.03 px
    estimate = estimate_scale(scene, model, GLOBAL)
    assert estimate.status == "unobservable" and "below" in estimate.reason
    near = estimate_scale(*facing_walls(2.0, None, noise), GLOBAL)
    assert near.status == "ok" and near.sfm_per_metre == pytest.approx(1.0, rel=0.02)


def test_a_picket_fence_is_ambiguous() -> None:
    # 0.2 m at 2 m is 6.4 px; four columns of the wall are 10.4 px, so 16.8 px fit as well: no edge of the wall is in view.
    estimate = estimate_scale(*facing_walls(2.0, 4, 1.0), GLOBAL)
    assert estimate.status == "ambiguous", estimate
    everything = [estimate.sfm_per_metre, *(m.sfm_per_metre for m in estimate.minima)]
    assert min(abs(s - 1.0) for s in everything) < 0.03
    assert any(m.chance > 0.025 for m in estimate.minima) and f"{estimate.minima[0].sfm_per_metre:.4g}" in estimate.reason


def found(closed: bool = True, doubt: str = "", chances: tuple[float, ...] = ()) -> Found:
    """What a solver found at s = 1, with other minima that are the better ones in these shares of the resamples."""
    scene, model = synthetic()
    curves = LocalCurves(objective(scene, model), (0, 1), (-0.1, 0.1))
    minima = tuple(Minimum(2.0 + k, 0.01, chance) for k, chance in enumerate(chances))
    return Found(0.0, 1.0, curves, closed, History(), 0, doubt, minima=minima)


SURE = Interval(0.01, (0.98, 1.02), None)


def test_the_first_reason_decides() -> None:
    wide = Interval(0.3, (0.5, 2.0), None)
    assert verdict_of(found(), SURE) == Verdict("ok", "")
    everything = found(closed=False, doubt="below the bracket", chances=(0.5,))
    assert verdict_of(everything, wide) == Verdict("unobservable", "below the bracket")
    flat = verdict_of(replace(everything, doubt=""), wide)
    assert flat.status == "unobservable" and "flat: between 0.9048 and 1.105 SfM" in flat.reason
    left_open = verdict_of(found(chances=(0.5,)), wide)
    assert left_open.status == "unobservable" and "by a factor of 1.8 to either side" in left_open.reason
    assert verdict_of(found(), Interval(0.5 / 1.96, (0.6, 1.6), None)).status == "ok"


def test_the_reason_of_a_wide_interval_names_the_misfit() -> None:
    wide = Interval(0.3, (0.5, 2.0), None, Misfit(1.234, 10))
    verdict = verdict_of(found(), wide)
    assert verdict.status == "unobservable" and "miss each other by 1.2 px" in verdict.reason
    assert "--scale.refine rotation" in verdict.reason
    assert "miss each other" not in verdict_of(found(), replace(wide, misfit=NO_MISFIT)).reason


def test_frames_have_to_agree_by_and_large() -> None:
    curves = LocalCurves(objective(*synthetic()), tuple(range(9)), (-0.1, 0.1))

    def verdict(apart: int, *, refined_later: bool = False) -> Verdict:
        some = replace(found(), curves=curves, disagreeing=tuple("abcdefghi"[:apart]))
        return verdict_of(some, SURE, refined_later=refined_later)

    assert verdict(3) == verdict(9, refined_later=True) == Verdict("ok", "")
    assert verdict(4).status == "unobservable" and verdict(4).reason.startswith("4 of 9 frames place the scale elsewhere")
    assert discord_of(3, 9) == "" and "wrong pairs" in discord_of(9, 9)


@pytest.mark.parametrize(("misfit_px", "disagree", "trusted"), [(0, 0, True), (1, 0, False), (0, 1, False), (1, 1, False)])
def test_the_curves_of_a_hardly_trained_model_are_not_trusted(misfit_px: int, disagree: int, trusted: bool) -> None:
    """Lego at 64 × 64 pixels, 12 frames and 200 steps: the truth is 15.46. Scatter and other minima alone do not tell."""
    kept = json.loads((Path(__file__).parent / "hardly_trained.json").read_text())
    frames, thetas = range(len(kept["losses"])), tuple(kept["thetas"])
    losses = {(i, t): FrameLoss(kept["losses"][i][k], kept["slopes"][i][k], 0.0) for i in frames for k, t in enumerate(thetas)}
    curves = LocalCurves(None, tuple(frames), thetas, losses)  # type: ignore[arg-type]  # nothing is rendered
    apart = ("",) * (disagree * kept["disagreeing"])
    hardly = Found(kept["theta"], 15.0, curves, True, History(), 0, disagreeing=apart)
    interval = interval_of(hardly, Bracket(*kept["bracket"]), None, Misfit(misfit_px * kept["misfit_px"], 0), 0)
    if trusted:
        assert interval.ci95 == pytest.approx((6.03, 9.70), abs=0.01) and verdict_of(hardly, interval).status == "ok"
    else:
        assert verdict_of(hardly, interval).status == "unobservable"


def test_minima_are_rivals_from_a_fortieth_of_the_resamples_on() -> None:
    assert verdict_of(found(chances=(0.025, 0.0)), SURE).status == "ok"
    verdict = verdict_of(found(chances=(0.4, 0.025, 0.03)), SURE)
    assert verdict.status == "ambiguous" and "as well at 2 and 4 SfM" in verdict.reason


def test_a_single_frame_is_not_asked_for_its_curves() -> None:
    assert verdict_of(found(closed=False), Interval(None, None, None)) == Verdict("ok", "")


def test_answers_outside_of_the_bracket() -> None:
    bracket = Bracket(0.5, 20.0)
    assert outside(math.log(0.5) + 1e-9, bracket) == outside(math.log(20.0) - 1e-9, bracket) == ""
    assert "0.4, lies below what the images can tell (0.5 to 20 SfM units per metre)" in outside(math.log(0.4), bracket)
    assert "lies above" in outside(math.log(21.0), bracket)
