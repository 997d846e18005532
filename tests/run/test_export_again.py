"""A run's own model, exported and imported again."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.helpers.tiny_run import TINY, recorded, strict_json


@pytest.mark.thorough
def test_a_model_that_was_exported_comes_back_with_the_same_scores(finished: Path, capture: Path, tmp_path: Path) -> None:
    """Held-out figures are the same: nothing is lost, the colour behind the Gaussians included."""
    assert recorded(["export", str(finished), "--out", str(tmp_path / "sfm"), "--frame", "sfm"])[1] == 0
    model, out = str(tmp_path / "sfm" / "rgb.ply"), tmp_path / "run"
    assert recorded(["run", str(capture), "--out", str(out), "--rgb-ply", model, *TINY])[1] == 0
    before, after = (strict_json(run / "metrics.json") for run in (finished, out))
    assert after["rgb"]["psnr"] == pytest.approx(before["rgb"]["psnr"], abs=0.01)
    assert after["rgb"]["ssim"] == pytest.approx(before["rgb"]["ssim"], abs=1e-3)


@pytest.mark.thorough
def test_a_model_in_metres_is_refused_with_the_remedy(
    finished: Path, capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert recorded(["export", str(finished), "--out", str(tmp_path / "metric")])[1] == 0
    model = str(tmp_path / "metric" / "rgb.ply")
    assert recorded(["run", str(capture), "--out", str(tmp_path / "run"), "--rgb-ply", model, *TINY])[1] == 2
    assert "--frame sfm" in capsys.readouterr().err
