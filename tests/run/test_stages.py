"""The table of stages."""

from __future__ import annotations

import subprocess
import sys

from rtgs.base.events import nobody
from rtgs.cli.table import all_commands
from rtgs.config import RunConfig
from rtgs.run.stages import STAGES, TITLES


def test_a_file_is_made_by_one_stage_only() -> None:
    made = [name for stage in STAGES for name in (*stage.makes, *stage.may_make, *stage.half_done)]
    assert len(made) == len(set(made))


def test_every_piece_of_work_has_a_title() -> None:
    names = [stage.name for stage in STAGES]
    assert [name for name in TITLES if name in names] == names
    assert len(set(TITLES.values())) == len(TITLES)


def test_every_stage_is_a_command() -> None:
    commands = set(all_commands(RunConfig(), nobody))
    assert {"eval" if stage.name == "evaluate" else stage.name for stage in STAGES} <= commands


def test_every_setting_belongs_to_a_stage() -> None:
    """A setting that no stage counts would change results and redo nothing."""
    config = RunConfig()
    counted = [stage.settings(config) for stage in STAGES]
    flat = [part for parts in counted for part in (parts if isinstance(parts, list) else [parts])]
    for name, value in vars(config).items():
        assert value is None or any(value is part for part in flat), name  # rgb_ply counts by its content


def test_the_table_is_light() -> None:
    heavy = ("torch", "numpy", "numba", "cv2", "pycolmap", "scipy", "matplotlib")
    code = f"import sys, rtgs.run.stages; print([m for m in {heavy!r} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"
