"""The rows of the tables."""

from __future__ import annotations

import pytest
from tests.helpers.tiny_experiment import CONFIG

from rtgs.experiments.tasks import scene_config
from rtgs.experiments.variants import BEYOND, PERTURBATIONS, REFERENCE_ROW, Variant, groups


@pytest.mark.parametrize("rows", [PERTURBATIONS, BEYOND], ids=["2", "beyond"])
def test_rows_have_keys_of_their_own_and_valid_settings(rows: tuple[Variant, ...]) -> None:
    assert len({v.key for v in rows}) == len(rows) and rows[0] is REFERENCE_ROW
    config = scene_config(CONFIG, "lego")
    captures = [v.applied_to(config) for v in rows]
    assert len({(*sorted(map(str, vars(c).items())), v.inverted, v.frames) for c, v in zip(captures, rows, strict=True)}) == len(
        rows
    )
    assert sorted(v.key for g in groups(rows) for v in g) == sorted(v.key for v in rows)
