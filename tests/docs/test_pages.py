"""What the pages promise: links lead somewhere, every command is shown, figures say where they come from."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from rtgs.base.events import nobody
from rtgs.cli.table import all_commands
from rtgs.config import RunConfig

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
TOP = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
PAGES = [*TOP, *sorted(p for p in DOCS.rglob("*.md") if "_build" not in p.parts)]
RESULTS = sorted(p for p in (DOCS / "results").glob("*.md") if p.stem != "index")
MAKER = runpy.run_path(str(DOCS / "make_results.py"))


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_and_pictures_lead_to_files(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if not re.match(r"https?:|#", target):
            assert (page.parent / target.split("#")[0]).exists(), target


def test_every_page_is_in_a_table_of_contents() -> None:
    listed = {
        (page.parent / f"{entry}.md").resolve()
        for page in DOCS.rglob("index.md")
        for tree in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for entry in tree.split("\n")
        if entry and not entry.startswith(":")
    }
    pages = {p.resolve() for p in DOCS.rglob("*.md") if "_build" not in p.parts} - {(DOCS / "index.md").resolve()}
    assert pages == listed


def test_every_command_is_shown() -> None:
    shown = re.findall(r"```\{cli-help\} ?(.*)\n```", (DOCS / "reference" / "cli.md").read_text(encoding="utf-8"))
    own = set(all_commands(RunConfig(), nobody)) - {"calibrate", "experiment"}
    assert own <= set(shown)
    for prefix in ("calibrate", "experiment"):
        arguments = [sys.executable, "-m", "rtgs", *prefix.split(), "--help"]
        done = subprocess.run(arguments, capture_output=True, text=True, check=True)
        commands = re.search(r"\{([a-z,-]+)\}", re.sub(r"\s", "", re.sub(r"[│\n]", "", done.stdout)))
        assert commands is not None
        for command in commands[1].split(","):
            assert f"{prefix} {command}" in shown


@pytest.mark.parametrize("page", RESULTS, ids=lambda p: p.stem)
def test_figures_say_where_they_come_from(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    measured = text.partition(MAKER["BEGIN"])[2].partition(MAKER["END"])[0]
    for row in ("command", "version", "machine", "date"):
        assert re.search(rf"^\| {row} \| \S", measured, flags=re.MULTILINE), row


def test_a_page_of_results_is_filled_between_its_marks() -> None:
    page = "# Title\n\n<!-- measured -->\nold\n<!-- end -->\n\nReading it\n"
    filled = MAKER["fill"](page, "| a |\n|---|\n| 1 |")
    assert filled == "# Title\n\n<!-- measured -->\n\n| a |\n|---|\n| 1 |\n\n<!-- end -->\n\nReading it\n"
    assert MAKER["tables"]("words\n| a |\n|---|\n| 1 |\nmore words\n| b |\n") == "| a |\n|---|\n| 1 |\n\n| b |"
    with pytest.raises(ValueError, match="the page has no"):
        MAKER["fill"]("# Title\n", "x")


def test_every_page_of_results_has_a_command_that_fills_it() -> None:
    assert sorted(MAKER["PAGES"]) == sorted(page.stem for page in RESULTS)
