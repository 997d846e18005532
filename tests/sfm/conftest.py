"""A photographed room, as a capture without poses."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from tests.helpers.photographed_room import write_room


@pytest.fixture(scope="session")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The capture, photographs alone."""
    root = tmp_path_factory.mktemp("room")
    write_room(root)
    return root


@pytest.fixture
def own_room(room: Path, tmp_path: Path) -> Path:
    """A copy to change."""
    return Path(shutil.copytree(room, tmp_path / "room"))
