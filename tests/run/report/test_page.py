"""The whole page of a made-up run: everything is said, nothing is fetched, missing parts are named."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.helpers.made_up_run import HELD_OUT, Page, make_run, page_of

from rtgs.base.errors import RtgsError
from rtgs.run.report import write_report
from rtgs.run.report.pieces import MOST_FRAMES
from rtgs.run.report.views import MOST_OVERLAYS


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Page:
    return page_of(make_run(tmp_path_factory.mktemp("report") / "run", renders=True))


@pytest.mark.thorough
def test_verdict_says_what_matters_in_words(whole: Page) -> None:
    for words in ("2.431 SfM units", "2.402 to 2.461", "baseline of 20 cm", "Scale found", "31.8 dB", "2.4 dB better", "0.58 °C"):
        assert words in whole.text, words
    assert "Do not rely" not in whole.text


def test_sections_stand_in_order(whole: Page) -> None:
    assert whole.headings == [
        *("What was run", "Scale", "Do the edges meet?", "Held-out RGB views", "Held-out thermal views", "Hot and cold spots"),
        *("Metrics", "Time taken", "Warnings"),
    ]
    assert "rgb.densify.max_gaussians" in whole.text and "60000" in whole.text
    assert "chosen: 2.431" in whole.text and "95 % interval" in whole.text  # the curve's legend is text
    assert "frame_0014" in whole.text and "blurred <motion>" in whole.text  # escaped: it came back as text, not as a tag
    assert "+2.40" in whole.text and "−0.390" in whole.text  # what the scale brought: dB, °C
    assert "16 min 06 s" in whole.text


def test_nothing_is_fetched(whole: Page) -> None:
    assert whole.images
    assert all(link.startswith(("data:image/", "#")) for link in whole.links), whole.links
    assert len(whole.ids) == len(set(whole.ids))  # two curves on one page must not share clip paths


def test_charts_hold_nothing_that_html_does_not_know(whole: Page) -> None:
    assert "<svg" in whole.source and "rdf:" not in whole.source and "<metadata" not in whole.source


def test_frames_are_few_and_evenly_chosen(whole: Page) -> None:
    # Before and after; three RGB and five thermal pictures a frame.
    assert len(whole.images) == MOST_OVERLAYS * 2 + MOST_FRAMES * (3 + 5) + 2
    assert HELD_OUT[0] in whole.text and HELD_OUT[-1] in whole.text
    assert HELD_OUT[1] not in whole.text


@pytest.mark.parametrize("name", ["config", "capture_summary", "scale", "metrics"])
def test_a_missing_part_is_named_with_its_command(tmp_path: Path, name: str) -> None:
    run = make_run(tmp_path / "run")
    (run / f"{name}.json").unlink()
    page = page_of(run)
    assert f"no {name}.json yet" in page.text and "To make it: rtgs run" in page.text
    assert not page.images


def test_an_empty_run_has_a_report(tmp_path: Path) -> None:
    page = page_of(tmp_path)
    assert "no scale so far" in page.text
    assert page.text.count("To make it:") >= 5
    assert "nan" not in page.text.lower().split() and "None" not in page.text


def test_a_folder_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match="no such run folder"):
        write_report(tmp_path / "absent")


@pytest.mark.parametrize("name", ["config", "capture_summary", "scale", "metrics", "thermal"])
@pytest.mark.parametrize("content", ['{"sfm_per_metre": 2.', "[1, 2]", '{"decisions": 3}'])
def test_a_damaged_file_is_an_error_that_names_it(tmp_path: Path, name: str, content: str) -> None:
    run = make_run(tmp_path / "run")
    (run / f"{name}.json").write_text(content, encoding="utf-8")
    with pytest.raises(RtgsError, match=rf"{name}\.json"):
        write_report(run)
    assert not (run / "report.html").exists()
