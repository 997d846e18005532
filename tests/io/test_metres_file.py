"""`metres.json`: what it may hold, and what is refused by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from rtgs.base.errors import RtgsError
from rtgs.io.metres_file import MetresFile, read_metres_file

FULL = {
    "camera_distances": [{"frames": ["0001", "0040"], "metres": 3.52, "std_m": 0.01}],
    "point_distances": [
        {"first": {"0001": [100.5, 200.0], "0002": [110, 201]}, "second": {"0001": [700, 200], "0002": [712, 203]}, "metres": 0.8}
    ],
    "board": {"inner_corners": "6x5", "square_m": 0.1},
    "tags": {"side_m": 0.16},
}


def written(root: Path, data: Any) -> Path:
    (root / "metres.json").write_text(json.dumps(data))
    return root


def test_a_capture_without_the_file_knows_nothing(tmp_path: Path) -> None:
    assert read_metres_file(tmp_path) == MetresFile()


def test_all_that_it_may_hold(tmp_path: Path) -> None:
    file = read_metres_file(written(tmp_path, FULL))
    assert file.camera_distances[0].frames == ("0001", "0040") and file.camera_distances[0].std_m == 0.01
    assert file.point_distances[0].second["0002"] == (712.0, 203.0) and file.point_distances[0].pick_px == 1.0
    assert file.board is not None and file.board.size == (6, 5)
    assert file.tags is not None and file.tags.dictionary == "DICT_APRILTAG_36h11"


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"distance": 3}, "distance"),
        ({"camera_distances": [{"frames": ["a", "a"], "metres": 1}]}, "twice"),
        ({"camera_distances": [{"frames": ["a", "b"], "metres": 0}]}, "metres"),
        ({"camera_distances": [{"frames": ["a", "b"], "metres": 2, "std_m": 3}]}, "std_m"),
        ({"camera_distances": [{"frames": ["a"], "metres": 2}]}, "frames"),
        ({"point_distances": [{"first": {"a": [1, 2]}, "second": {"a": [1, 2], "b": [3, 4]}, "metres": 1}]}, "first"),
        ({"board": {"inner_corners": "6x5", "square_m": -1}}, "square_m"),
        ({"tags": {"side_m": 0}}, "side_m"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, data: Any, said: str) -> None:
    with pytest.raises(RtgsError, match=said) as error:
        read_metres_file(written(tmp_path, data))
    assert "metres.json" in str(error.value)
