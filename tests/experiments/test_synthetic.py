"""`rtgs experiment synthetic` on one tiny scene: replays, records that outlive a kill, and the table's statistics."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import to_json
from rtgs.config import PAPER_EPSILON, DensifyConfig, RgbConfig, ScaleConfig, SyntheticExperimentConfig
from rtgs.experiments import synthetic
from rtgs.experiments.ablation import ABLATION
from rtgs.experiments.curves import Curves, _Mean, replay
from rtgs.experiments.records import ExperimentFolder, Record
from rtgs.experiments.rivals import INERF_L1, INERF_SSIM, MUTUAL_INFORMATION, NGF_PYRAMID, OURS, RIVALS, Own, Rival
from rtgs.experiments.rivals.ngf_pyramid import Ngf
from rtgs.experiments.scenery import Trial
from rtgs.experiments.synthetic import RUN, scene_config, synthetic_experiment, tasks_of
from rtgs.experiments.tables import Summary, ablation_table, rows_table, table_1
from rtgs.experiments.variants import BEYOND, FAR, FAR_SCENE, PERTURBATIONS, REFERENCE_ROW, Variant, groups
from rtgs.scale import Objective
from rtgs.scale.adam import adam
from rtgs.synthetic.capture import camera_path, compiled_scene, noise_rng, true_rig, written_rig

CONFIG = SyntheticExperimentConfig(
    size=64,
    frames=9,
    scenes=("lego",),
    seeds=1,
    rgb=RgbConfig(steps=120, sh_degree=0, densify=DensifyConfig(max_gaussians=1500), random_points=1500),
    workers=1,
)


class StopError(Exception):
    pass


@dataclass(frozen=True)
class Bench:
    """A bench that was stopped after its first trial and gone on with, one record having been removed in between."""

    out: Path
    times: dict[Path, int]  # of what there was before going on
    removed: dict[str, Any]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    out = tmp_path_factory.mktemp("bench") / "out"

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
    return Bench(out, times, removed)


@pytest.fixture(scope="module")
def finished(bench: Bench) -> Path:
    return bench.out


@pytest.fixture(scope="module")
def trial(finished: Path) -> Trial:
    return Trial.read(finished / "scenes" / "lego", scene_config(CONFIG, "lego"), 0)


def test_a_killed_bench_goes_on(bench: Bench) -> None:
    made = {p.name.split(".")[3] for p in bench.times if p.parent.name == "records"}
    assert made >= {r.key for r in RIVALS} and OURS.key not in made and (bench.out / "table_1.md") not in bench.times
    assert {p: p.stat().st_mtime_ns for p in bench.times} == bench.times
    records = {r.method: r for r in ExperimentFolder(bench.out, synthetic._settings(CONFIG)).records()}
    assert set(records) == {r.key for r in RIVALS} | {OURS.key, RUN}
    assert records[OURS.key].found == pytest.approx(bench.removed["found"], rel=1e-6)


def test_what_it_writes(finished: Path) -> None:
    text = (finished / "table_1.md").read_text(encoding="utf-8")
    assert "64 × 64, 9 pairs of which 7 for training, 1 scenes × 1 seeds" in text
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


SMOOTH = Rival("smooth", "ε of the size of edges", lambda thermal, mask: Ngf(thermal, mask, epsilon=0.1), smooth_px=0.5)
PAPER = ScaleConfig(solver="adam", steps=30, learning_rate=0.01)


@dataclass(frozen=True)
class Stage:
    """A trial's training frames: their renderer, and thermal images in [0, 1]."""

    objective: Objective
    images: dict[str, NDArray[np.float32]]
    mask: NDArray[np.bool_]

    def curves(self, *rivals: Rival, pixel: float) -> Curves:
        return Curves(self.objective, {r.key: (r, [r.loss(i, self.mask) for i in self.images.values()]) for r in rivals}, pixel)


@pytest.fixture(scope="module")
def stage(trial: Trial) -> Stage:
    scene, model = trial.scene(REFERENCE_ROW, trial.temperatures(None)), trial.model
    frames, weights = scene.train_frames, PAPER.level_weights
    objective = Objective(
        scene, model.gaussians, model.background, model.settings, frames, level_weights=weights, epsilon=PAPER_EPSILON
    )
    return Stage(objective, synthetic._normalised(scene), scene.capture.thermal_mask)


@pytest.mark.parametrize(
    ("rival", "tolerance"),
    [(INERF_L1, 1e-3), (INERF_SSIM, 1e-3), (SMOOTH, 2e-4), (NGF_PYRAMID, 1e-9)],  # the last renders at each step
    ids=lambda value: value.key if isinstance(value, Rival) else "",
)
def test_a_replay_is_the_run(rival: Rival, tolerance: float, stage: Stage, trial: Trial) -> None:
    """Adam on curves against Adam that renders at every step, from both sides."""
    curves = stage.curves(rival, pixel=0.03 * trial.truth)
    run = rival.objective(stage.objective, stage.images, stage.mask)
    for start in (0.88, 1.12):
        expected, path = adam(run, math.log(start * trial.truth), PAPER)
        found, replayed = replay(curves, rival.key, math.log(start * trial.truth), PAPER)
        assert abs(found - expected) < tolerance
        assert np.ptp(path.sfm_per_metre) > 0.01 * trial.truth, "it stood still"
        assert replayed.loss[0] == pytest.approx(path.loss[0], rel=0.01)


def test_what_is_rendered_for_one_serves_the_others(stage: Stage, trial: Trial) -> None:
    curves, before = stage.curves(SMOOTH, INERF_L1, NGF_PYRAMID, pixel=0.03 * trial.truth), stage.objective.renders
    step = 0.5 * curves.pixel
    curves.node(20 * step, SMOOTH.key)
    for rival in (SMOOTH, INERF_L1, NGF_PYRAMID):
        curves.node(20 * step, rival.key)
    assert curves.renders == stage.objective.renders - before == len(stage.images)
    curves.node(20.1 * step, NGF_PYRAMID.key)  # smooth losses need no such crowd
    assert curves.around(INERF_L1.key, 20.2 * step) == (20 * step, None)
    assert curves.around(NGF_PYRAMID.key, 20.2 * step) == (20.1 * step, None)
    assert curves.seconds_each(SMOOTH.key) > 0


def test_slopes_at_nodes_and_between(stage: Stage, trial: Trial) -> None:
    curves = stage.curves(SMOOTH, pixel=0.03 * trial.truth)
    step, losses = 0.5 * curves.pixel, [SMOOTH.loss(i, stage.mask) for i in stage.images.values()]
    ends = np.array([[loss(*stage.objective.picture(i, math.log(k * step))) for i, loss in enumerate(losses)] for k in (60, 61)])
    for chosen, values in ((None, ends.mean(axis=1)), ([1, 4], ends[:, [1, 4]].mean(axis=1))):
        mean = _Mean(curves, SMOOTH.key, chosen)
        between = 0.75 * values[0] + 0.25 * values[1]
        assert mean.loss_and_slope(0, math.log(60 * step * (1 + 1e-12))) == pytest.approx(tuple(values[0]), rel=1e-6)
        assert mean.loss_and_slope(0, math.log(60.25 * step)) == pytest.approx(tuple(between), rel=1e-6)
    assert curves.renders == 2 * len(stage.images)
    least = _Mean(curves, SMOOTH.key, None)
    assert least.loss_and_slope(0, math.log(0.2 * step)) == least.loss_and_slope(0, math.log(step))


def test_a_wrong_length_moves_the_curve_and_nothing_else(trial: Trial) -> None:
    """So descents under it are replayed on the curves of the true length."""
    clean = trial.temperatures(None)
    row = next(v for v in PERTURBATIONS if v.key == "length_2")
    assert row in next(g for g in groups(PERTURBATIONS) if REFERENCE_ROW in g)
    true, wrong = trial.scene(REFERENCE_ROW, clean), trial.scene(row, clean)
    model, name = trial.model, true.train_frames[0].name
    a, b = true.thermal_from_world(name, 1.02 * trial.truth), wrong.thermal_from_world(name, trial.truth)
    assert np.allclose(a.matrix(), b.matrix(), atol=1e-12) and row.length_factor == pytest.approx(1.02)
    assert model is trial.model


def test_seeds_share_the_photographs_and_differ_in_the_rig() -> None:
    configs = [replace(scene_config(CONFIG, "lego"), rig_seed=k) for k in (None, 0, 1)]
    centre = compiled_scene("lego").model.centre
    paths = [np.stack([p.matrix() for p in camera_path(c, centre)]) for c in configs]
    assert np.array_equal(paths[0], paths[1]) and np.array_equal(paths[0], paths[2])
    rigs = [true_rig(c) for c in configs]
    poses = [r.rgb_from_thermal for r in rigs]
    assert all(r.rgb == rigs[0].rgb and r.thermal == rigs[0].thermal for r in rigs)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert np.linalg.norm(poses[i].translation - poses[j].translation) > 0.01
        assert np.abs(poses[i].rotation - poses[j].rotation).max() > 1e-3
    assert all(np.linalg.norm(p.translation) == pytest.approx(0.2) for p in poses)
    assert not np.array_equal(noise_rng(configs[1], 0).normal(size=9), noise_rng(configs[2], 0).normal(size=9))
    tilted = [written_rig(replace(c, rig_direction_error=0.02), r) for c, r in zip(configs, rigs, strict=True)]
    for told, true in zip(tilted, poses, strict=True):
        apart = told.rgb_from_thermal.translation - true.translation
        assert np.linalg.norm(apart) == pytest.approx(0.004, rel=0.01)


def test_the_object_stays_in_view() -> None:
    """Whatever side the thermal camera sits on, the object's centre is near the middle of its picture."""
    for seed in range(20):
        config = replace(scene_config(CONFIG, "chair"), rig_seed=seed)
        rig, centre = true_rig(config), compiled_scene("chair").model.centre
        for pose in camera_path(config, centre):
            x, y, z = (pose @ rig.rgb_from_thermal).inverse().apply(np.array(centre))
            assert z > 0 and math.hypot(x, y) / z < math.tan(math.radians(8))


@pytest.mark.parametrize("rows", [PERTURBATIONS, BEYOND], ids=["2", "beyond"])
def test_rows_have_keys_of_their_own_and_valid_settings(rows: tuple[Variant, ...]) -> None:
    assert len({v.key for v in rows}) == len(rows) and rows[0] is REFERENCE_ROW
    config = scene_config(CONFIG, "lego")
    captures = [v.capture(config) for v in rows]
    for capture in captures:
        capture.check()
    assert len({(*sorted(map(str, vars(c).items())), v.inverted, v.frames) for c, v in zip(captures, rows, strict=True)}) == len(
        rows
    )
    assert sorted(v.key for g in groups(rows) for v in g) == sorted(v.key for v in rows)


def record(error_pct: float, start: float = 1.3, method: str = OURS.key, **changes: object) -> Record:
    found = 4.0 * (1 + error_pct / 100)
    values = {"scene": "lego", "seed": 0, "half_width_pct": 0.5, "product_error_pct": error_pct / 2, **changes}
    return Record(variant="reference", method=method, truth=4.0, start=4.0 * start, found=found, error_pct=error_pct,
                  iterations=5, renders=100, seconds=2.0, **values)  # fmt: skip  # type: ignore[arg-type]


def test_statistics() -> None:
    records = [record(e, seed=k) for k, e in enumerate((0.1, 0.3, 1.9, 2.0, 2.1, 50.0))]
    summary = Summary.of(OURS.key, records)
    assert summary.median_pct == pytest.approx(1.95) and summary.success_pct == pytest.approx(400 / 6)
    assert summary.p90_pct == pytest.approx(np.percentile([0.1, 0.3, 1.9, 2.0, 2.1, 50.0], 90))
    assert (summary.trials, summary.iterations, summary.renders, summary.seconds) == (6, 5, 100, 2.0)
    assert Summary.of(OURS.key, records, product=True).median_pct == pytest.approx(0.975)
    starts = Summary.of_starts([record(0.0, 0.5), record(0.0, 1.01), record(0.0, 1.4)])
    assert starts.median_pct == pytest.approx(40.0) and starts.success_pct == pytest.approx(100 / 3)
    assert math.isnan(starts.renders)


def test_the_table_says_where_ours_is_worst() -> None:
    paper = [record(e, method=NGF_PYRAMID.key, seed=k) for k, e in enumerate((0.2, 30.0))]
    own = [record(e, seed=k) for k, e in enumerate((0.45, 0.1))]
    text, summaries = table_1([*paper, *own], CONFIG)
    assert "at most +0.25 points (lego, seed 0: 0.45 %)" in text and "inside in 2 of 2" in text
    assert [s.method for s in summaries] == ["init", NGF_PYRAMID.key, OURS.key]
    assert "| 2 | 15.10 |" in text and "1 scenes × 2 seeds" in text
    assert "3 trials on 2 scenes" in table_1([*paper, record(0.1, scene="ship")], CONFIG)[0]
    replayed, run = record(0.2, method=MUTUAL_INFORMATION.key), record(0.21, method=RUN)
    assert "at most 0.010 points of s apart" in table_1([*paper, *own, replayed, run], CONFIG)[0]


def test_ablations_change_one_setting_each() -> None:
    def settings(method: Own) -> dict[str, object]:
        return {**to_json(method.config), **asdict(method.comparison)}

    own = settings(OURS)
    for method in ABLATION:
        changed = [name for name, value in settings(method).items() if value != own[name]]
        assert changed == ["epsilon", "per_edge"] if method.key == "ours_paper_loss" else len(changed) == 1, method.key
    assert len({m.key for m in (OURS, *ABLATION)}) == len(ABLATION) + 1
    text = ablation_table([record(0.1), record(0.3, seed=1), record(3.0, method=ABLATION[0].key)], CONFIG)
    assert "| nothing | 0.200 |" in text and "| ε = 1e-6 as in the paper | 3.000 | 3.000 | 3.000 | 0 |" in text


def test_work_is_seed_by_seed() -> None:
    tasks = tasks_of(SyntheticExperimentConfig(seeds=2))
    assert [t.scene for t in tasks[:6]] == list(SyntheticExperimentConfig().scenes) and {t.seed for t in tasks[:6]} == {0}
    assert sum(t.methods == (RUN,) for t in tasks) == 6 and len(tasks) == 18
    every = tasks_of(SyntheticExperimentConfig(table="all"))
    assert {v.key for t in every for v in t.variants} == {v.key for v in (*PERTURBATIONS, *BEYOND, FAR)}
    assert {t.scene for t in every if FAR in t.variants} == {FAR_SCENE} and all(FAR not in t.variants[1:] for t in every)


def test_rows_beyond_the_paper() -> None:
    """The plain's row has verdicts in place of a scale."""
    far = [replace(record(40.0, scene=FAR_SCENE), variant=FAR.key, status="unobservable")] * 3
    text = rows_table([record(0.1), *far], (REFERENCE_ROW, FAR), "title")
    assert "| 0.10 / 100 |" in text and "3 of 3 unobservable" in text
