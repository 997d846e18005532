"""The scale in the report: doubt comes first, curves and minima are shown, and what was refined stands in a table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from tests.helpers.made_up_run import HELD_OUT, SFM_PER_METRE, estimate, make_run, page_of
from tests.helpers.scale_scenes import RIG

from rtgs.metres.combine import combine
from rtgs.records.metres import MetresSource
from rtgs.run.folder import RunFolder
from rtgs.scale.records import Freedom, Minimum, Refinement, Scan


@pytest.mark.parametrize("status", ["ambiguous", "unobservable"])
def test_a_scale_in_doubt_is_said_first(tmp_path: Path, status: Literal["ambiguous", "unobservable"]) -> None:
    run = make_run(tmp_path / "run")
    doubtful = replace(estimate(), status=status, reason="flow is under half a pixel", ci95=None, std_log=None)
    RunFolder(run).write_scale(doubtful)
    page = page_of(run)
    assert "Do not rely on this number: flow is under half a pixel." in page.text and "Scale found" not in page.text


def test_a_solver_with_steps_shows_them(tmp_path: Path) -> None:
    text = page_of(make_run(tmp_path / "run")).text
    assert "Refinement by Adam" in text and "single frames" not in text


def test_a_search_shows_its_minima_its_frames_and_the_curve_beside_the_answer(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    s = tuple(SFM_PER_METRE * f for f in (0.98, 0.99, 1.0, 1.01, 1.02))
    curves: dict[str, tuple[float, ...]] = {n: (0.9 + k * 0.01, 0.88, 0.87, 0.88, 0.9) for k, n in enumerate(HELD_OUT)}
    found = replace(
        estimate(),
        solver="global",
        minima=(Minimum(sfm_per_metre=7.125, loss_above=0.01, chance=0.12),),
        disagreeing=("frame_<9>",),
        local=Scan(s, (0.9, 0.88, 0.87, 0.88, 0.9), (0.0,) * 5, curves),
        blur_px=2.8,
    )
    RunFolder(run).write_scale(found)
    text = page_of(run).text
    assert "other minimum: 7.125" in text and "7.125 (better in 12 % of resamples)" in text
    assert "frame_<9>" in text and "single frames" in text  # escaped: it came back as text
    assert "Blur of the thermal lens" in text and "2.8 px" in text
    assert "scan and Gauss-Newton" in text and "Refinement by" not in text


def test_what_was_refined_stands_in_a_table(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    freedoms = [
        Freedom("thermal <focal>", "%", mean=-1.25, std=0.3, prior_std=2.0, decided=True),
        Freedom("time offset", "frame intervals", mean=0.01, std=0.28, prior_std=0.2887, decided=False),
    ]
    refinement = Refinement.of(1.2345, freedoms, np.eye(3), RIG)
    RunFolder(run).write_scale(replace(estimate(), refinement=refinement))
    page = page_of(run)
    assert "thermal <focal> 0 ± 2 % −1.250 ± 0.300 % yes" in page.text  # escaped, and its cells in order
    assert "time offset 0 ± 0.289 frame intervals +0.010 ± 0.280 frame intervals no, as calibrated" in page.text
    assert "Without this the scale would be 1.2345" in page.text


def with_sources(run: Path, *sources: MetresSource, absent: dict[str, str] | None = None) -> None:
    RunFolder(run).write_scale(replace(estimate(), metres=combine(sources, absent)))


def test_metres_from_one_source_have_no_section(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    with_sources(run, MetresSource("baseline", SFM_PER_METRE, 0.006, "edges"))
    assert "What metres rest on" not in page_of(run).headings


def test_metres_from_two_sources_stand_in_a_table_with_what_they_rest_on(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    gps = MetresSource("gps", 2.44, 0.01, "RTK of 40 <photographs>")
    with_sources(run, MetresSource("baseline", SFM_PER_METRE, 0.006, "edges"), gps, absent={"board": "no image shows it"})
    page = page_of(run)
    assert "What metres rest on" in page.headings and "from baseline and gps" in page.text
    assert "RTK of 40 <photographs>." in page.text and "no image shows it." in page.text
    assert "disagree" not in page.text.split("What was run")[0]


def test_sources_that_disagree_are_the_first_thing_that_is_said(tmp_path: Path) -> None:
    run = make_run(tmp_path / "run")
    with_sources(run, MetresSource("baseline", SFM_PER_METRE, 0.006, "edges"), MetresSource("gps", 2.9, 0.02, "RTK"))
    first = page_of(run).text.split("One metre is")[0]
    assert "Sources of metres disagree" in first and "gps 2.9" in first and "Scale found" not in first


def test_metres_do_not_need_the_baseline(tmp_path: Path) -> None:
    run, gps = make_run(tmp_path / "run"), MetresSource("gps", 2.9, 0.02, "RTK")
    doubtful = replace(estimate(), status="unobservable", reason="flow is under half a pixel", ci95=None, std_log=None)
    RunFolder(run).write_scale(replace(doubtful, metres=combine([gps], {"baseline": "flow is under half a pixel"})))
    text = page_of(run).text
    assert "One metre is 2.9 SfM units" in text and "Do not rely" not in text and "flow is under half a pixel" in text
