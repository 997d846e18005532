"""Scores of rows that do not have the same pixels."""

from __future__ import annotations

import numpy as np
import pytest
from tests.helpers.wall_scene import PLANE_M, wall_scene

from rtgs.config import RealExperimentConfig
from rtgs.experiments.real_rows import Row
from rtgs.experiments.real_scores import common_mask, score
from rtgs.experiments.strategies.planar import PlanarScene


def test_every_row_is_scored_on_the_pixels_of_all() -> None:
    scene, _ = wall_scene()
    planar = PlanarScene.of(scene, PLANE_M)
    assert 0.5 < planar.thermal_valid.mean() < 1
    holes = {f.name: np.where(planar.thermal_valid, f.thermal, np.nan) for f in scene.held_out_frames}
    whole = {f.name: f.thermal for f in scene.held_out_frames}
    rows = [Row("ours", "Ours", 1.0, whole), Row("planar", "Planar", None, holes), Row("manual", "Manual", None, {}, why="no")]
    np.testing.assert_array_equal(common_mask(scene, rows), planar.thermal_valid)
    # An error where Planar has no pixel does not count for Ours either.
    spoilt = {n: np.where(planar.thermal_valid, image, 99.0).astype(np.float32) for n, image in whole.items()}
    scored = score(scene, [Row("ours", "Ours", 1.0, spoilt), rows[1]], RealExperimentConfig(), lambda *_: None)
    assert scored.means["ours"]["mae_c"] == 0
    assert scored.means["ours"]["peak_c"] == 0 and set(scored.names) >= {"peak_c", "peak_p90_c"}
    assert scored.share == pytest.approx(planar.thermal_valid.mean())
