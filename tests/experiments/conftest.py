"""A tiny synthetic experiment that several test files look at."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.helpers.tiny_experiment import CONFIG, StopError, Stopped

from rtgs.experiments.rivals import OURS
from rtgs.experiments.synthetic import synthetic_experiment
from rtgs.experiments.tasks import scene_config
from rtgs.experiments.trials import Trial


@pytest.fixture(scope="session")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Stopped:
    out = tmp_path_factory.mktemp("experiment") / "out"

    def stop(done: int, total: int, text: str) -> None:
        if done == 2:  # the RGB model and a trial
            raise StopError

    with pytest.raises(StopError):
        synthetic_experiment(out, CONFIG, progress=stop)
    own = out / "records" / f"lego.0.reference.{OURS.key}.json"
    removed = json.loads(own.read_text(encoding="utf-8"))
    own.unlink()  # as after a change of the search
    times = {p: p.stat().st_mtime_ns for p in out.rglob("*") if p.is_file() and p.name != "settings.json"}
    synthetic_experiment(out, CONFIG)
    return Stopped(out, times, removed)


@pytest.fixture(scope="session")
def finished(stopped: Stopped) -> Path:
    return stopped.out


@pytest.fixture(scope="session")
def trial(finished: Path) -> Trial:
    return Trial.read(finished / "scenes" / "lego", scene_config(CONFIG, "lego"), 0)
