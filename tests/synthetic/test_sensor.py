"""The thermal sensor's options, each by itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.helpers.synthetic_captures import SMALL, clean_c, thermal_c

from rtgs.synthetic import write_capture

pytest.importorskip("embreex")


def test_sensor_options(tmp_path: Path) -> None:
    base = replace(SMALL, netd_c=0.0)
    plain = write_capture(tmp_path / "plain", base)
    write_capture(tmp_path / "blur", replace(base, blur_px=2.0))
    gained = write_capture(tmp_path / "gain", replace(base, gain_jitter=0.2))
    write_capture(tmp_path / "bare", replace(base, thermal_clean=False))
    assert not (tmp_path / "bare" / "ground_truth").exists()
    for name in plain.world_from_rgb:
        clean, recorded = clean_c(tmp_path / "plain", name), thermal_c(tmp_path / "plain", name)
        assert np.abs(clean - recorded).max() <= 0.00501  # half a count
        np.testing.assert_array_equal(clean_c(tmp_path / "blur", name), clean)
        blurred = thermal_c(tmp_path / "blur", name)
        assert np.abs(np.diff(blurred, axis=0)).max() < 0.5 * np.abs(np.diff(recorded, axis=0)).max()
        gain = gained.gains[name]
        assert 0.8 <= gain <= 1.2 and gain != 1 and plain.gains[name] == 1
        stretched = clean.mean() + gain * (clean - clean.mean())
        np.testing.assert_allclose(thermal_c(tmp_path / "gain", name), stretched, atol=0.006)
