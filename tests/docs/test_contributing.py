"""The camera format that CONTRIBUTING shows works as it stands there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from rtgs.base.errors import RtgsError

TEXT = (Path(__file__).parents[2] / "CONTRIBUTING.md").read_text(encoding="utf-8")


@pytest.fixture
def made_up_format() -> Any:
    (code,) = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
    names: dict[str, Any] = {"__name__": "rtgs.io.cameras.acme"}
    exec(code, names)
    return names["FORMAT"]


def test_the_made_up_camera_is_read(made_up_format: Any, tmp_path: Path) -> None:
    photograph = tmp_path / "A1.jpg"
    Image.fromarray(np.zeros((240, 320, 3), np.uint8)).save(photograph)
    assert not made_up_format.recognises(photograph)
    np.full((120, 160), 29515, dtype="<u2").tofile(photograph.with_suffix(".raw"))
    assert made_up_format.recognises(photograph) and made_up_format.frame_name(photograph) == "A1"
    shot = made_up_format.read(photograph)
    np.testing.assert_allclose(shot.radiometry.celsius(shot.counts), np.full((120, 160), 22.0), atol=1e-3)
    assert shot.visible.file == photograph.read_bytes()


def test_a_file_of_another_size_is_refused(made_up_format: Any, tmp_path: Path) -> None:
    np.zeros(7, dtype="<u2").tofile(tmp_path / "A1.raw")
    with pytest.raises(RtgsError, match=r"A1\.raw: holds 7 numbers"):
        made_up_format.read(tmp_path / "A1.jpg")
