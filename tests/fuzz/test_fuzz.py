"""A short campaign over every reader: what is read is accepted, or refused with a message."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import pytest
from tests.fuzz.campaign import fuzz, table
from tests.fuzz.readers import READERS, input_of

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="bounds of memory and time as Linux has them")


@pytest.mark.thorough
def test_a_short_campaign_over_all_readers() -> None:
    counts = fuzz(800)
    assert not any(c.wrong for c in counts.values()), table(counts)
    assert list(counts) == [reader.name for reader in READERS]
    assert all(c.inputs for c in counts.values())
    assert sum(c.accepted for c in counts.values()) > 200 and sum(c.refused for c in counts.values()) > 200


def test_the_same_number_gives_the_same_input(tmp_path: Path) -> None:
    reader = next(r for r in READERS if r.name == "rig.json")
    made = []
    for seed in (3, 4, 3):
        random.seed()  # nobody else's numbers matter
        input_of(reader, seed, tmp_path / "case")
        made.append((tmp_path / "case" / "rig.json").read_bytes())
    assert made[0] == made[2] != made[1]
