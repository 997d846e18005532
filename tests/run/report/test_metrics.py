"""Scores in the report: their unit, their sign, and why one is missing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from tests.helpers.made_up_run import evaluation, make_run, page_of, summary

from rtgs.base.json_records import write_json
from rtgs.evaluation.records import Evaluation, ModelScores


def changed(run: Path, found: Evaluation) -> Path:
    found.write(run / "metrics.json")
    return run


def test_relative_thermal_counts_are_not_called_degrees(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    write_json(run / "capture_summary.json", replace(summary(), unit="counts"))
    counts = ModelScores(psnr=31.84, ssim=0.941, mae_counts=40.26)
    changed(run, Evaluation(evaluation().rgb, counts, replace(counts, mae_counts=50.0), count_range=(100.0, 900.0)))
    page = page_of(run)
    assert "no radiometric calibration" in page.text and "°C" not in page.text
    assert "MAE, counts" in page.text and "40.3" in page.text and "−9.7" in page.text
    assert "range 100.0 to 900.0 counts" in page.text


def test_a_loss_is_not_sold_as_a_gain(tmp_path: Path) -> None:
    worse = replace(evaluation(), thermal=replace(evaluation().thermal, psnr=28.44))
    assert "1.0 dB worse" in page_of(changed(make_run(tmp_path / "run"), worse)).text


def test_without_held_out_frames_there_is_no_score(tmp_path: Path) -> None:
    page = page_of(changed(make_run(tmp_path / "run"), Evaluation(ModelScores(), ModelScores(), ModelScores())))
    assert "On views it never saw" not in page.text and "Thermal, scale ignored" in page.text


@pytest.mark.thorough
def test_why_a_score_is_missing(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    assert "LPIPS (AlexNet)" not in page_of(run).text
    noted = replace(evaluation(), notes=("LPIPS: no <weights>.",))
    assert "LPIPS: no <weights>. Then rtgs eval" in page_of(changed(run, noted)).text
    scored = replace(evaluation(), thermal=replace(evaluation().thermal, lpips=0.3456))
    text = page_of(changed(run, scored)).text
    assert "0.346" in text and "LPIPS (AlexNet)" in text
