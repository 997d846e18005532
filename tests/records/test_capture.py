"""Frames and their images; which frames are for training, validation and evaluation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.records.capture import Frame, Split

NAMES = [f"{i:02d}" for i in range(20)]


def test_a_split_is_a_rule_over_frames_in_name_order() -> None:
    """The default is what the conventions say of held-out frames: 0, 8, 16, …"""
    assert sorted(Split().held_out_names(NAMES)) == ["00", "08", "16"]
    assert sorted(Split().validation_names(NAMES)) == ["04", "12"]
    assert sorted(Split(held_out=5).held_out_names(NAMES)) == ["00", "05", "10", "15"]
    assert sorted(Split(validation=5).validation_names(NAMES)) == ["02", "07", "12", "17"]


def test_a_split_can_name_its_frames() -> None:
    split = Split(held_out=frozenset({"03"}), validation=frozenset({"07", "09"}))
    assert split.held_out_names(NAMES) == {"03"}
    assert split.validation_names(NAMES) == {"07", "09"}


@pytest.mark.parametrize("rule", [1, 0, -8])
def test_a_rule_that_leaves_no_frame_for_a_fit_is_refused(rule: int) -> None:
    with pytest.raises(RtgsError, match=r"split\.held_out"):
        Split(held_out=rule)
    with pytest.raises(RtgsError, match=r"split\.validation"):
        Split(validation=rule)


RGB, THERMAL = np.zeros((3, 4, 3), np.float32), np.full((3, 4), 20.0, np.float32)


def gone() -> NDArray[np.float32]:
    raise RtgsError("the file has gone")


def test_a_frame_gives_the_image_whether_it_holds_it_or_loads_it() -> None:
    held, loaded = Frame("a", RGB, THERMAL), Frame("a", lambda: RGB, lambda: THERMAL)
    for frame in (held, loaded, replace(loaded, name="b"), replace(held, thermal=lambda: THERMAL)):
        assert frame.rgb is RGB and frame.thermal is THERMAL


def test_an_image_is_loaded_when_it_is_asked_for_and_not_before() -> None:
    frame = Frame("a", gone, THERMAL)
    assert frame.thermal is THERMAL
    repr(frame)
    with pytest.raises(RtgsError, match="gone"):
        _ = frame.rgb


def test_another_thermal_image_leaves_the_rest_of_a_frame_as_it_is() -> None:
    frame = Frame("a", gone, gone, time_s=3.0)
    other = frame.with_thermal(THERMAL)
    assert (other.name, other.time_s) == ("a", 3.0) and other.thermal is THERMAL
    for broken in (lambda: other.rgb, lambda: frame.thermal):
        with pytest.raises(RtgsError, match="gone"):
            broken()


def test_a_frame_has_both_images() -> None:
    with pytest.raises(TypeError, match="thermal"):
        Frame("a", RGB)
