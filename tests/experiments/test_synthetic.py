"""`rtgs experiment synthetic` on one tiny scene: records that outlive a stop, folders that are refused, the work in order."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import pytest
from tests.helpers.tiny_experiment import CONFIG, Stopped

from rtgs.base.errors import RtgsError
from rtgs.config import SyntheticExperimentConfig
from rtgs.experiments.methods import MI_WITHOUT_REPLAY
from rtgs.experiments.records import ExperimentFolder
from rtgs.experiments.rivals import OURS, RIVALS
from rtgs.experiments.synthetic import synthetic_experiment
from rtgs.experiments.tasks import folder_settings, tasks_of
from rtgs.experiments.variants import BEYOND, FAR, FAR_SCENE, PERTURBATIONS

pytestmark = pytest.mark.thorough


def test_what_was_stopped_goes_on(stopped: Stopped) -> None:
    made = {p.name.split(".")[3] for p in stopped.times if p.parent.name == "records"}
    assert made >= {r.key for r in RIVALS} and OURS.key not in made and (stopped.out / "table_1.md") not in stopped.times
    assert {p: p.stat().st_mtime_ns for p in stopped.times} == stopped.times
    records = {r.method: r for r in ExperimentFolder(stopped.out, folder_settings(CONFIG)).records()}
    assert set(records) == {r.key for r in RIVALS} | {OURS.key, MI_WITHOUT_REPLAY}
    assert records[OURS.key].found == pytest.approx(stopped.removed["found"], rel=1e-6)


def test_what_it_writes(finished: Path) -> None:
    text = (finished / "table_1.md").read_text(encoding="utf-8")
    assert "64 × 64, 9 pairs of which 7 for training, 1 scenes × 1 seeds" in text
    assert text.startswith("# Table I") and "| command | `rtgs experiment synthetic --out DIR --size 64 --frames 9" in text
    assert str(finished) not in text
    for title in ("Init", "iNeRF (SSIM)", "NGF pyramid (the paper)", "mutual information", "| ours |", "| lego |"):
        assert title in text, title
    rows = list(csv.DictReader((finished / "trials.csv").open(encoding="utf-8", newline="")))
    assert len(rows) == len(RIVALS) + 2 and {r["scene"] for r in rows} == {"lego"}
    for name in ("errors_by_start.svg", "errors_cumulative.svg"):
        assert "</svg>" in (finished / name).read_text(encoding="utf-8")


def test_folders_of_others_are_refused(finished: Path, tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match=r"settings\.json"):
        synthetic_experiment(finished, replace(CONFIG, size=72))
    (tmp_path / "thesis.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(RtgsError, match="new or empty"):
        synthetic_experiment(tmp_path, CONFIG)
    for change in ({"seeds": 0}, {"scenes": ()}, {"scenes": ("lego", "lego")}, {"size": 16}, {"workers": 0}):
        with pytest.raises(RtgsError, match=next(iter(change))):
            synthetic_experiment(tmp_path / "new", replace(CONFIG, **change))
    assert not (tmp_path / "new").exists()


def test_work_is_seed_by_seed() -> None:
    tasks = tasks_of(SyntheticExperimentConfig(seeds=2))
    assert [t.scene for t in tasks[:6]] == list(SyntheticExperimentConfig().scenes) and {t.seed for t in tasks[:6]} == {0}
    assert sum(t.methods == (MI_WITHOUT_REPLAY,) for t in tasks) == 6 and len(tasks) == 18
    every = tasks_of(SyntheticExperimentConfig(table="all"))
    assert {v.key for t in every for v in t.variants} == {v.key for v in (*PERTURBATIONS, *BEYOND, FAR)}
    assert {t.scene for t in every if FAR in t.variants} == {FAR_SCENE} and all(FAR not in t.variants[1:] for t in every)
