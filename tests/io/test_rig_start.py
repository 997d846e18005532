"""A thermal camera of which only a start is known: what may be left out, and what is put in its place."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from rtgs.base.errors import RtgsError
from rtgs.io.rig_start import completed_thermal

SIZE: dict[str, Any] = {"width": 160, "height": 120}
FROM_SIZE = SIZE | {"model": "PINHOLE", "cx": 80, "cy": 60}


def test_size_and_field_of_view_are_enough() -> None:
    focal = 80 / math.tan(math.radians(28.5))
    assert completed_thermal(Path("rig.json"), SIZE | {"fov_deg": 57}) == FROM_SIZE | {
        "fl_x": pytest.approx(focal),
        "fl_y": pytest.approx(focal),
    }


@pytest.mark.parametrize("axis", ["fl_x", "fl_y"])
def test_the_focal_length_of_one_axis_stands_for_both(axis: str) -> None:
    assert completed_thermal(Path("rig.json"), SIZE | {axis: 150}) == FROM_SIZE | {"fl_x": 150, "fl_y": 150}


def test_what_is_given_stays() -> None:
    given = SIZE | {"model": "OPENCV", "cx": 79.0, "cy": 61.0, "fl_x": 150, "fl_y": 151, "k1": -0.3}
    assert completed_thermal(Path("rig.json"), given) == given


def test_no_focal_length_at_all_is_refused_with_both_remedies() -> None:
    with pytest.raises(RtgsError, match=r"fl_x is missing.*focal length in pixels.*fov_deg"):
        completed_thermal(Path("rig.json"), SIZE)
