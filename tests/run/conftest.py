"""A capture, and one whole run of it for all tests of this folder."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from tests.helpers.recorder import Recorder
from tests.helpers.tiny_run import SYNTH, TINY, recorded

from rtgs.synthetic import write_capture


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures") / "lego"
    write_capture(folder, SYNTH)
    return folder


@pytest.fixture(scope="session")
def recording(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Recorder]:
    """A whole run by one command, and what it told its listener."""
    out = tmp_path_factory.mktemp("runs") / "lego"
    recorder, code = recorded(["run", str(capture), "--out", str(out), *TINY])
    assert code == 0
    return out, recorder


@pytest.fixture(scope="session")
def finished(recording: tuple[Path, Recorder]) -> Path:
    """A whole run. Tests read it, and copy it to change it."""
    return recording[0]


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A copy of the whole run."""
    return Path(shutil.copytree(finished, tmp_path / "run"))
