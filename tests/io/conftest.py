"""The capture that tests of this folder start from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.helpers.captures import NAMES, RADIOMETRY, RGB, RGB_FROM_THERMAL, THERMAL, thermal_counts

from rtgs.io.rig import write_rig
from rtgs.records.rig import Rig


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A small, correct capture without poses."""
    root = tmp_path / "capture"
    (root / "rgb").mkdir(parents=True)
    (root / "thermal").mkdir()
    rng = np.random.default_rng(0)
    for i, name in enumerate(NAMES):
        Image.fromarray(rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)).save(root / "rgb" / f"{name}.png")
        Image.fromarray(thermal_counts(4800 + i)).save(root / "thermal" / f"{name}.tiff")
    write_rig(root / "rig.json", Rig(RGB, THERMAL, RGB_FROM_THERMAL), RADIOMETRY)
    return root
