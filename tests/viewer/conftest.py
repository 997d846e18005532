"""A run with known truth, written once for all tests of this folder."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from tests.helpers.viewed_wall import write_wall_capture, write_wall_run

from rtgs.viewer.contents import Contents, read_contents
from rtgs.viewer.engine import Engine


@pytest.fixture(scope="session")
def wall_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Tests read it, and copy it to change it."""
    root = tmp_path_factory.mktemp("wall")
    return write_wall_run(root / "run", write_wall_capture(root / "capture"))


@pytest.fixture(scope="session")
def contents(wall_run: Path) -> Contents:
    return read_contents(wall_run)


@pytest.fixture
def engine(contents: Contents) -> Engine:
    return Engine(contents)


@pytest.fixture
def run(wall_run: Path, tmp_path: Path) -> Path:
    """A copy that can be changed."""
    return Path(shutil.copytree(wall_run, tmp_path / "run"))
