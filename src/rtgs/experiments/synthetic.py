"""`rtgs experiment synthetic`: the scale on scenes whose truth is known, by this method and its rivals (the paper's Tables I and II)."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import active_children, get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtgs.base.json_records import to_json
from rtgs.base.progress import Progress
from rtgs.config import ScaleConfig, SceneName, SynthConfig, SyntheticExperimentConfig, SyntheticTable
from rtgs.experiments.ablation import ABLATION
from rtgs.experiments.curves import Curves, replay
from rtgs.experiments.records import ExperimentFolder, Record
from rtgs.experiments.rivals import INERF_L1, MUTUAL_INFORMATION, NGF_PYRAMID, OURS, OURS_REFINED, RIVALS, Own, Rival
from rtgs.experiments.scenery import Trial, prepare
from rtgs.experiments.tables import RUN, write_tables
from rtgs.experiments.variants import FAR, FAR_SCENE, ROWS, Variant, groups
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.scale import Objective, ScaleEstimate
from rtgs.scale.adam import descend_by_adam
from rtgs.scale.bracket import flow_per_unit
from rtgs.scale.objective import scaled_thermal

PAPER = ScaleConfig(solver="adam")  # 200 steps at 5e-3, all frames
WIDEST_PIXEL = 0.03  # of s: what stands for a pixel of flow where s hardly flows
SETTLED_SHARE = 0.005
OWN = {own.key: own for own in (OURS, OURS_REFINED, *ABLATION)}
_METHODS: dict[SyntheticTable, tuple[str, ...]] = {
    "1": (*(r.key for r in RIVALS), OURS.key),
    "2": (INERF_L1.key, NGF_PYRAMID.key, OURS.key, OURS_REFINED.key),
    "beyond": (INERF_L1.key, NGF_PYRAMID.key, OURS.key),
    "ablation": (OURS.key, *(own.key for own in ABLATION)),
}


@dataclass(frozen=True)
class Task:
    """What one process does in one go: some rows of one trial by some methods."""

    scene: SceneName
    seed: int
    variants: tuple[Variant, ...]
    methods: tuple[str, ...]


def synthetic_experiment(out: Path, config: SyntheticExperimentConfig, *, progress: Progress | None = None) -> list[Path]:
    """Make what is missing of a table's records, then the table.

    Args:
        out: folder; what is there of the same settings is kept.
        progress: called with (pieces of work done, in all, text).

    Returns:
        The files written.

    Raises:
        RtgsError: a setting out of range, or a folder of other settings.
    """
    config.check()
    folder = ExperimentFolder(out, folder_settings(config))
    tasks = [t for t in tasks_of(config) if _missing(folder, t)]
    scenes = list(dict.fromkeys(t.scene for t in tasks))
    done, total = 0, len(scenes) + len(tasks)

    def tell(text: str) -> None:
        if progress is not None:
            progress(done, total, text)

    def complete(work: dict[Future[None], str]) -> None:
        nonlocal done
        for future in as_completed(work):
            future.result()
            done += 1
            tell(work[future])

    tell("RGB models")
    if tasks:
        with _pool(config.workers) as pool:
            try:
                complete({pool.submit(_prepare, str(out), config, name): f"{name}: RGB model" for name in scenes})
                complete({pool.submit(_perform, str(out), config, t): f"{t.scene}, seed {t.seed}" for t in tasks})
            except BaseException as error:
                if isinstance(error, KeyboardInterrupt):  # SIGTERM reaches this process alone
                    for process in active_children():
                        process.terminate()
                pool.shutdown(cancel_futures=True)  # waits for what is under way: nothing is written after the call has ended
                raise
    return write_tables(folder, config)


def tasks_of(config: SyntheticExperimentConfig) -> list[Task]:
    """All the work behind a table, seed by seed, so that what is stopped early still has every scene."""
    tasks = []
    for table in config.tables:
        for seed in range(config.seeds):
            tasks += [Task(name, seed, ROWS[table], _METHODS[table]) for name in config.scenes]
            if table == "beyond":
                tasks.append(Task(FAR_SCENE, seed, (FAR,), _METHODS[table]))
        if table == "1":
            tasks += [Task(name, 0, ROWS[table], (RUN,)) for name in config.scenes]
    return tasks


def scene_config(config: SyntheticExperimentConfig, scene: SceneName) -> SynthConfig:
    """The capture that all trials of a scene share."""
    return SynthConfig(scene=scene, frames=config.frames, size=config.size, thermal_clean=False)


def folder_settings(config: SyntheticExperimentConfig) -> dict[str, object]:
    """What must agree for an earlier call's records to be kept."""
    return {"size": config.size, "frames": config.frames, "rgb": to_json(config.rgb)}


def _missing(folder: ExperimentFolder, task: Task) -> list[tuple[Variant, str]]:
    return [(v, m) for v in task.variants for m in task.methods if not folder.has(task.scene, task.seed, v.key, m)]


@contextmanager
def _pool(workers: int | None) -> Iterator[ProcessPoolExecutor]:
    """Processes with one thread each: trials are independent, threads within one would only wait for each other."""
    with ProcessPoolExecutor(workers or os.cpu_count() or 1, get_context("spawn"), _single_threaded) as pool:
        yield pool


def _single_threaded() -> None:
    import numba
    import torch

    numba.set_num_threads(1)
    torch.set_num_threads(1)


def _prepare(out: str, config: SyntheticExperimentConfig, scene: SceneName) -> None:
    folder = ExperimentFolder(Path(out), folder_settings(config))
    prepare(folder.scene(scene), scene_config(config, scene), config.rgb)


def _perform(out: str, config: SyntheticExperimentConfig, task: Task) -> None:
    folder = ExperimentFolder(Path(out), folder_settings(config))
    trial = Trial.read(folder.scene(task.scene), scene_config(config, task.scene), task.seed)
    for rows in groups(task.variants):
        missing = [(v, m) for v, m in _missing(folder, task) if v in rows]
        if not missing:
            continue
        clean = trial.temperatures(rows[0].capture(trial.config).thermal_size)
        scenes = {v.key: trial.scene(v, clean) for v in rows}
        for variant, method in missing:
            if method in OWN:
                folder.write(_by_ours(OWN[method], trial, task, variant, scenes[variant.key]))
            elif method == RUN:
                folder.write(_by_run(trial, task, variant, scenes[variant.key]))
        # The paper's first: smooth losses are served by its renders.
        descents = [(v, r) for v, m in missing for r in RIVALS if r.key == m]
        descents.sort(key=lambda d: d[1] is not NGF_PYRAMID)
        for record in _by_replay(trial, task, scenes, descents):
            folder.write(record)


def _by_ours(own: Own, trial: Trial, task: Task, variant: Variant, scene: Scene) -> Record:
    started = time.process_time()
    estimate = own(_reduced(scene, variant), trial.model)
    seconds = time.process_time() - started
    return _record(
        trial,
        task,
        variant,
        own.key,
        estimate.sfm_per_metre,
        iterations=len(estimate.history.step),
        renders=estimate.renders,
        seconds=seconds,
        half_width_pct=_half_width_pct(estimate),
        status=estimate.status,
    )


def _by_run(trial: Trial, task: Task, variant: Variant, scene: Scene) -> Record:
    """Adam, rendering at every step."""
    objective = MUTUAL_INFORMATION.objective(_pictures(trial, scene), normalised_thermal(scene), scene.capture.thermal_mask)
    started = time.process_time()
    path = descend_by_adam(objective, math.log(trial.start), PAPER)
    seconds = time.process_time() - started
    return _record(
        trial,
        task,
        variant,
        RUN,
        math.exp(path.theta),
        iterations=_iterations(path.history.sfm_per_metre),
        renders=PAPER.steps * len(objective.frames),
        seconds=seconds,
    )


def _pictures(trial: Trial, scene: Scene) -> Objective:
    """What descents render: of all training frames."""
    return Objective(scene, trial.model, scene.train_frames, EdgeLoss())


def _by_replay(trial: Trial, task: Task, scenes: dict[str, Scene], descents: Sequence[tuple[Variant, Rival]]) -> Iterator[Record]:
    """Descents of rows that share their cameras, on curves rendered once."""
    if not descents:
        return
    # A rig's length alone may differ between these rows; the curves are over the true length's scale.
    first = scenes[descents[0][0].key]
    rig, factor = first.rig, descents[0][0].length_factor
    rig = replace(rig, rgb_from_thermal=rig.rgb_from_thermal.with_baseline_scaled(1.0 / factor))
    scene = replace(first, capture=replace(first.capture, rig=rig))
    frames = scene.train_frames
    flow = flow_per_unit(scene, trial.model)
    pixel = min(1.0 / float(np.percentile(flow, 90)), WIDEST_PIXEL * trial.truth)
    thermal = {v.key: normalised_thermal(scenes[v.key]) for v, _ in descents}
    mask = scene.capture.thermal_mask
    losses = {f"{v.key}.{r.key}": (r, [r.loss(image, mask) for image in thermal[v.key].values()]) for v, r in descents}
    curves = Curves(_pictures(trial, scene), losses, pixel)
    for variant, rival in descents:
        chosen = None if variant.frames is None else [frames.index(f) for f in _chosen(scene, variant)]
        key, factor = f"{variant.key}.{rival.key}", variant.length_factor
        path = replay(curves, key, math.log(trial.start * factor), PAPER, chosen)
        renders = PAPER.steps * (len(frames) if chosen is None else len(chosen))
        yield _record(
            trial,
            task,
            variant,
            rival.key,
            math.exp(path.theta) / factor,
            iterations=_iterations(path.history.sfm_per_metre),
            renders=renders,
            seconds=renders * curves.seconds_each(key),
        )


def _record(trial: Trial, task: Task, variant: Variant, method: str, found: float, **more: object) -> Record:
    def error(factor: float) -> float:
        return 100 * abs(found * factor / trial.truth - 1)

    values = {"error_pct": error(1.0), "product_error_pct": error(variant.length_factor), **more}
    return Record(task.scene, task.seed, variant.key, method, trial.truth, trial.start, found, **values)  # type: ignore[arg-type]


def _chosen(scene: Scene, variant: Variant) -> list[Frame]:
    """The training frames of a row, evenly spaced."""
    train = scene.train_frames
    count = len(train) if variant.frames is None else min(variant.frames, len(train))
    return [train[i] for i in np.unique(np.linspace(0, len(train) - 1, count).round().astype(int))]


def _reduced(scene: Scene, variant: Variant) -> Scene:
    """The scene with the training frames of a row alone."""
    return replace(scene, world_from_rgb={f.name: scene.world_from_rgb[f.name] for f in _chosen(scene, variant)})


def normalised_thermal(scene: Scene) -> dict[str, NDArray[np.float32]]:
    """Thermal images of the training frames in [0, 1], over their common range."""
    return scaled_thermal({f.name: f.thermal for f in scene.train_frames}, scene.capture.thermal_mask)


def _iterations(path: Sequence[float]) -> int:
    """Steps until s stays close to the last one."""
    away = np.flatnonzero(np.abs(np.array(path) / path[-1] - 1) > SETTLED_SHARE)
    return int(away[-1]) + 1 if len(away) else 0


def _half_width_pct(estimate: ScaleEstimate) -> float | None:
    if estimate.ci95 is None or not all(0 < end < math.inf for end in estimate.ci95):
        return None
    return 50 * math.log(estimate.ci95[1] / estimate.ci95[0])
