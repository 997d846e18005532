"""Where a table comes from, in words that anybody may read."""

from __future__ import annotations

import platform
from dataclasses import replace
from datetime import date
from pathlib import Path

import pytest

from rtgs import __version__
from rtgs.config import DensifyConfig, ManualConfig, RealExperimentConfig, RgbConfig, SyntheticExperimentConfig
from rtgs.experiments.provenance import Page, Provenance, command_line

SYNTHETIC, REAL = SyntheticExperimentConfig(), RealExperimentConfig()


@pytest.mark.parametrize(
    ("settings", "flags"),
    [
        (SYNTHETIC, ""),
        (replace(SYNTHETIC, table="2", seeds=3), " --table 2 --seeds 3"),
        (replace(SYNTHETIC, scenes=("lego", "ship")), " --scenes lego ship"),
        (replace(SYNTHETIC, rgb=RgbConfig(steps=120)), " --rgb.quality default --rgb.steps 120"),
        (
            replace(SYNTHETIC, rgb=replace(SYNTHETIC.rgb, densify=DensifyConfig(max_gaussians=500))),
            " --rgb.densify.max-gaussians 500",
        ),
        (replace(REAL, manual=ManualConfig(("a b", "c"), 1.5)), " --manual.frames 'a b' c --manual.metres 1.5"),
        (replace(REAL, depth_model=Path("/home/somebody/models/small")), " --depth-model small"),  # no path of the machine
        (replace(REAL, thermal=replace(REAL.thermal, drift="auto")), " --thermal.drift auto"),
    ],
)
def test_a_command_has_the_flags_that_differ(settings: SyntheticExperimentConfig | RealExperimentConfig, flags: str) -> None:
    assert command_line("rtgs experiment", settings, type(settings)()) == f"rtgs experiment{flags}"


def test_a_page_has_title_provenance_and_body(tmp_path: Path) -> None:
    provenance = Provenance.of("rtgs experiment synthetic --out DIR")
    path = Page("A table", "| a |\n|---|\n| 1 |\n").write(tmp_path / "table.md", provenance)
    assert path.read_text(encoding="utf-8") == (
        "# A table\n\n| measured with | |\n|---|---|\n| command | `rtgs experiment synthetic --out DIR` |\n"
        f"| version | {__version__} |\n"
        f"| machine | {provenance.cpu}, {provenance.cores} core{'s' * (provenance.cores != 1)}, Python {provenance.python} |\n"
        f"| date | {date.today().isoformat()} |\n\n| a |\n|---|\n| 1 |\n"
    )
    assert provenance.cpu and provenance.cores >= 1 and platform.node() not in provenance.markdown()
