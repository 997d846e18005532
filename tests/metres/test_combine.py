"""Sources of metres together: agreement is not called disagreement, and a wrong source is named."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rtgs.metres.combine import combine
from rtgs.records.metres import MetresSource

STDS = {"baseline": 0.004, "gps": 0.012, "distance": 0.005, "board": 0.001}


def readings(seed: int, wrong: str = "", by: float = 1.2) -> list[MetresSource]:
    random = np.random.default_rng(seed)
    return [
        MetresSource(name, 2.5 * math.exp(std * random.normal()) * (by if name == wrong else 1.0), std, "")
        for name, std in STDS.items()
    ]


def test_sources_that_are_right_are_hardly_ever_said_to_disagree() -> None:
    together = [combine(readings(seed)) for seed in range(400)]
    assert np.mean([bool(m.disagreement) for m in together]) < 0.03
    assert np.mean([m.ci95 is not None and m.ci95[0] < 2.5 < m.ci95[1] for m in together]) > 0.9


@pytest.mark.parametrize("wrong", STDS)
@pytest.mark.parametrize("by", [0.8, 1.2])
def test_a_source_that_is_off_by_a_fifth_is_named_and_does_not_count(wrong: str, by: float) -> None:
    for seed in range(20):
        together = combine(readings(seed, wrong, by))
        assert wrong in together.disagreement and wrong not in together.rests_on
        assert together.sfm_per_metre == pytest.approx(2.5, rel=0.02)


def test_of_two_that_disagree_the_more_certain_one_counts_and_the_interval_holds_both() -> None:
    two = [MetresSource("gps", 3.0, 0.02, ""), MetresSource("board", 2.5, 0.001, "")]
    together = combine(two)
    assert together.rests_on == ("board",) and together.sfm_per_metre == 2.5
    assert "gps" in together.disagreement and together.ci95 is not None and together.ci95[1] == pytest.approx(3.0)


def test_two_that_agree_are_weighted_by_their_variances() -> None:
    together = combine([MetresSource("a", 2.0, 0.01, ""), MetresSource("b", 2.04, 0.02, "")])
    assert together.sfm_per_metre == pytest.approx(math.exp((4 * math.log(2.0) + math.log(2.04)) / 5))
    assert together.std_log == pytest.approx(0.01 / math.sqrt(1.25)) and not together.disagreement


def test_a_single_source_is_kept_to_the_last_bit() -> None:
    together = combine([MetresSource("baseline", 2.4312345678912345, 0.01, "")], {"gps": "no tags"})
    assert together.sfm_per_metre == 2.4312345678912345 and together.chance is None and together.absent == {"gps": "no tags"}


def test_without_a_source_there_are_no_metres() -> None:
    together = combine([], {"baseline": "flat"})
    assert together.sfm_per_metre is None and together.ci95 is None
