"""What a row of Table III is kept by: what its files hold, not where or when they were written."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from rtgs.experiments.strategies.strategy import content_of


def test_a_copy_or_a_touch_keeps_a_row_and_a_changed_byte_does_not(tmp_path: Path) -> None:
    model = tmp_path / "model"
    (model / "parts").mkdir(parents=True)
    (model / "config.json").write_text("{}")
    (model / "parts" / "weights.bin").write_bytes(b"weights")
    before, alone = content_of(model), content_of(model / "config.json")
    shutil.copytree(model, tmp_path / "elsewhere" / "model")
    os.utime(model / "config.json", (0, 0))
    assert content_of(model) == content_of(tmp_path / "elsewhere" / "model") == before
    assert content_of(model / "config.json") == alone
    (model / "parts" / "weights.bin").write_bytes(b"Weights")
    assert content_of(model) != before
    assert content_of(None) is None
