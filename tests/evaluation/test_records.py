"""`metrics.json`: its layout, and that it is read as it was written."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from rtgs.base.errors import RtgsError
from rtgs.evaluation.records import Evaluation, ModelScores, Scores

RGB = ModelScores.of({"a": Scores(psnr=20.0, ssim=0.5), "b": Scores(psnr=30.0, ssim=0.75)})
THERMAL = ModelScores.of({"a": Scores(psnr=31.0, ssim=0.9, lpips=0.2, mae_c=0.5)})
EVALUATION = Evaluation(RGB, THERMAL, None, (10.0, 40.0), None, ("No LPIPS of RGB.",), {"sfm": 1.5, "evaluate": 2.0})


def test_the_layout_names_what_was_computed_and_nothing_else(tmp_path: Path) -> None:
    EVALUATION.write(tmp_path / "metrics.json")
    assert json.loads((tmp_path / "metrics.json").read_text(encoding="utf-8")) == {
        "rgb": {"psnr": 25.0, "ssim": 0.625, "per_frame": {"a": {"psnr": 20.0, "ssim": 0.5}, "b": {"psnr": 30.0, "ssim": 0.75}}},
        "thermal": {
            **{"psnr": 31.0, "ssim": 0.9, "lpips": 0.2, "mae_c": 0.5},
            "per_frame": {"a": {"psnr": 31.0, "ssim": 0.9, "lpips": 0.2, "mae_c": 0.5}},
        },
        "temperature_range_c": [10.0, 40.0],
        "notes": ["No LPIPS of RGB."],
        "timings_s": {"sfm": 1.5, "evaluate": 2.0},
    }
    empty = Evaluation(ModelScores(), ModelScores(), ModelScores(), count_range=(0.0, 9.0))
    empty.write(tmp_path / "metrics.json")
    nothing: dict[str, object] = {"per_frame": {}}
    expected = {"rgb": nothing, "thermal": nothing, "thermal_naive": nothing, "count_range": [0.0, 9.0]}
    assert json.loads((tmp_path / "metrics.json").read_text(encoding="utf-8")) == expected


@pytest.mark.parametrize("naive", [None, THERMAL])
def test_what_is_written_is_read_again(tmp_path: Path, naive: ModelScores | None) -> None:
    evaluation = replace(EVALUATION, thermal_naive=naive, notes=[])
    evaluation.write(tmp_path / "metrics.json")
    assert replace(Evaluation.read(tmp_path / "metrics.json"), notes=[]) == evaluation


@pytest.mark.parametrize("content", ["{", "[]", "{}", '{"rgb": {"psnr": "high"}, "thermal": {}}'])
def test_a_damaged_file_is_named(tmp_path: Path, content: str) -> None:
    (tmp_path / "metrics.json").write_text(content, encoding="utf-8")
    with pytest.raises(RtgsError, match=r"metrics\.json"):
        Evaluation.read(tmp_path / "metrics.json")


def test_files_of_earlier_versions_have_no_peak_errors(tmp_path: Path) -> None:
    (tmp_path / "metrics.json").write_text('{"rgb": {"psnr": 20.0}, "thermal": {"psnr": 30.0, "mae_c": 0.5, "per_frame": {}}}')
    thermal = Evaluation.read(tmp_path / "metrics.json").thermal
    assert thermal.mae_c == 0.5 and thermal.peak_c is None


def test_peak_errors_are_means_over_the_frames_that_have_peaks() -> None:
    frames = {"a": Scores(mae_c=1.0), "b": Scores(mae_c=2.0, peak_c=3.0, peak_p90_c=5.0), "c": Scores(mae_c=3.0, peak_c=5.0)}
    mean = ModelScores.of(frames)
    assert (mean.mae_c, mean.peak_c, mean.peak_p90_c) == (2.0, 4.0, 5.0)


def test_a_mean_needs_the_score_of_every_frame() -> None:
    mean = ModelScores.of({"a": Scores(psnr=20.0, lpips=0.1), "b": Scores(psnr=22.0)})
    assert mean.psnr == 21.0 and mean.lpips is None and ModelScores.of({}) == ModelScores()
