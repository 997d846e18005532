"""One table of scores: everything that is scored has a name, a unit and decimals."""

from __future__ import annotations

from dataclasses import fields

from rtgs.evaluation.records import Scores
from rtgs.metrics.scores import SCORES


def test_every_score_of_the_evaluation_is_in_the_table() -> None:
    names = [f.name for f in fields(Scores)]
    assert [name for name in SCORES if name in names] == names


def test_values_in_words() -> None:
    assert [SCORES[n].heading for n in ("psnr", "ssim", "mae_c")] == ["PSNR, dB", "SSIM", "MAE, °C"]
    assert SCORES["psnr"].text(31.2) == "31.20 dB" and SCORES["ssim"].text(0.9) == "0.9000"
    assert SCORES["mae_counts"].number(40.26) == "40.3"
