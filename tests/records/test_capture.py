"""Which frames are for training, validation and evaluation."""

from __future__ import annotations

import pytest

from rtgs.base.errors import RtgsError
from rtgs.records.capture import Split

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
