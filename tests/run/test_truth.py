"""A whole run against the truth: what a user would measure on a capture whose temperatures and scale are known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from rtgs.cli import main

MAE_BOUND_C = 1.4  # measured: 1.18 °C at this size, where a pixel holds much of an object's edge
MEDIAN_BOUND_C = 0.2  # measured: 0.09 °C
SCALE_BOUND = 0.01  # measured: 0.0027


@pytest.mark.thorough
def test_temperatures_and_scale_of_a_run_are_those_of_the_scene(tmp_path: Path) -> None:
    """Held-out thermal views, drawn by the command that a user has, against the scene's own temperatures without noise."""
    capture, run, views = tmp_path / "capture", tmp_path / "run", tmp_path / "views"
    main(
        [
            "synth",
            "--out",
            str(capture),
            *["--scene", "lego", "--frames", "24", "--size", "96", "--supersampling", "1", "--seed", "3"],
        ]
    )
    main(["run", str(capture), "--out", str(run), "--rgb.steps", "500"])
    names = [f"frame_{i:03d}" for i in range(0, 24, 8)]
    main(["render", str(run), "--out", str(views), "--viewpoint", "thermal", "--frames", *names])

    truth = json.loads((capture / "ground_truth.json").read_text(encoding="utf-8"))["sfm_per_metre"]
    scale = json.loads((run / "scale.json").read_text(encoding="utf-8"))
    assert scale["status"] == "ok" and scale["ci95"][0] <= truth <= scale["ci95"][1]
    assert abs(scale["sfm_per_metre"] / truth - 1.0) < SCALE_BOUND

    def read(folder: Path, suffix: str) -> np.ndarray:
        return np.stack([np.asarray(Image.open(folder / f"{name}{suffix}")) for name in names])

    error_c = np.abs(read(views, ".thermal.tiff") - read(capture / "ground_truth" / "thermal_clean", ".tiff"))
    assert error_c.mean() < MAE_BOUND_C
    assert np.median(error_c) < MEDIAN_BOUND_C

    metrics = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["thermal"]["mae_c"] < 0.7 * metrics["thermal_naive"]["mae_c"]
