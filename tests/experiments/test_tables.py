"""Statistics of records, and the tables that say them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tests.helpers.tiny_experiment import CONFIG

from rtgs.experiments.ablation import ABLATION
from rtgs.experiments.methods import MI_WITHOUT_REPLAY
from rtgs.experiments.records import Record
from rtgs.experiments.rivals import MUTUAL_INFORMATION, NGF_PYRAMID, OURS
from rtgs.experiments.tables import Summary, ablation_table, rows_table, table_1
from rtgs.experiments.variants import FAR, FAR_SCENE, REFERENCE_ROW


def record(error_pct: float, start: float = 1.3, method: str = OURS.key, **changes: Any) -> Record:
    found = 4.0 * (1 + error_pct / 100)
    values: dict[str, Any] = {"scene": "lego", "seed": 0, "half_width_pct": 0.5, "product_error_pct": error_pct / 2, **changes}
    return Record(variant="reference", method=method, truth=4.0, start=4.0 * start, found=found, error_pct=error_pct,
                  iterations=5, renders=100, seconds=2.0, **values)  # fmt: skip


def test_statistics() -> None:
    records = [record(e, seed=k) for k, e in enumerate((0.1, 0.3, 1.9, 2.0, 2.1, 50.0))]
    summary = Summary.of(OURS.key, records)
    assert summary.median_pct == pytest.approx(1.95) and summary.success_pct == pytest.approx(400 / 6)
    assert summary.p90_pct == pytest.approx(np.percentile([0.1, 0.3, 1.9, 2.0, 2.1, 50.0], 90))
    assert (summary.trials, summary.iterations, summary.renders, summary.seconds) == (6, 5, 100, 2.0)
    assert Summary.of(OURS.key, records, product=True).median_pct == pytest.approx(0.975)
    starts = Summary.of_starts([record(0.0, 0.5), record(0.0, 1.01), record(0.0, 1.4)])
    assert starts.median_pct == pytest.approx(40.0) and starts.success_pct == pytest.approx(100 / 3)
    assert math.isnan(starts.renders)


def test_the_table_says_where_ours_is_worst() -> None:
    paper = [record(e, method=NGF_PYRAMID.key, seed=k) for k, e in enumerate((0.2, 30.0))]
    own = [record(e, seed=k) for k, e in enumerate((0.45, 0.1))]
    page, summaries = table_1([*paper, *own], CONFIG)
    text = page.body
    assert "at most +0.25 points (lego, seed 0: 0.45 %)" in text and "inside in 2 of 2" in text
    assert [s.method for s in summaries] == ["init", NGF_PYRAMID.key, OURS.key]
    assert "| 2 | 15.10 |" in text and "1 scenes × 2 seeds" in page.title
    assert "3 trials on 2 scenes" in table_1([*paper, record(0.1, scene="ship")], CONFIG)[0].title
    replayed, run = record(0.2, method=MUTUAL_INFORMATION.key), record(0.21, method=MI_WITHOUT_REPLAY)
    assert "at most 0.010 points of s apart" in table_1([*paper, *own, replayed, run], CONFIG)[0].body


def test_the_ablation_table_shows_what_was_changed() -> None:
    text = ablation_table([record(0.1), record(0.3, seed=1), record(3.0, method=ABLATION[0].key)], CONFIG).body
    assert "| nothing | 0.200 |" in text and "| ε = 1e-6 as in the paper | 3.000 | 3.000 | 3.000 | 0 |" in text


def test_rows_beyond_the_paper() -> None:
    """The plain's row has verdicts in place of a scale."""
    far = [replace(record(40.0, scene=FAR_SCENE), variant=FAR.key, status="unobservable")] * 3
    text = rows_table([record(0.1), *far], (REFERENCE_ROW, FAR))
    assert "| 0.10 / 100 |" in text and "3 of 3 unobservable" in text
