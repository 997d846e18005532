"""The rig that is told differs from the true one by the errors that were asked for."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.helpers.synthetic_captures import SMALL

from rtgs.synthetic import write_capture
from rtgs.synthetic.rig import true_rig, written_rig

pytest.importorskip("embreex")


@pytest.mark.parametrize("field", ["rig_length_error", "rig_direction_error", "rig_rotation_error_deg", "thermal_focal_error"])
def test_calibration_errors_change_what_is_told_not_what_is_seen(field: str) -> None:
    change: dict[str, Any] = {field: 0.02}
    config = replace(SMALL, **change)
    rig = true_rig(config)
    told = written_rig(config, rig)
    untouched = written_rig(SMALL, rig)
    np.testing.assert_array_equal(untouched.rgb_from_thermal.matrix(), rig.rgb_from_thermal.matrix())
    assert untouched.thermal == rig.thermal and told.rgb == rig.rgb
    t, t_told = rig.rgb_from_thermal.translation, told.rgb_from_thermal.translation
    length = np.linalg.norm(t_told) / np.linalg.norm(t)
    tilt = np.linalg.norm(np.cross(t, t_told)) / (t @ t_told)
    turned = rig.rgb_from_thermal.rotation.T @ told.rgb_from_thermal.rotation
    angle_deg = math.degrees(
        np.linalg.norm([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2
    )
    assert length == pytest.approx(1.02 if field == "rig_length_error" else 1.0)
    assert tilt == pytest.approx(0.02 if field == "rig_direction_error" else 0.0, abs=1e-9)
    assert angle_deg == pytest.approx(0.02 if field == "rig_rotation_error_deg" else 0.0, abs=1e-6)
    assert told.thermal.fl_x / rig.thermal.fl_x == pytest.approx(1.02 if field == "thermal_focal_error" else 1.0)


def test_a_rig_without_baseline_can_be_made(tmp_path: Path) -> None:
    """The case in which no scale can be observed."""
    truth = write_capture(tmp_path / "x", replace(SMALL, baseline_m=0.0, rig_direction_error=0.01, frames=1, size=16))
    assert truth.rig.baseline_m == 0
