"""The work behind the synthetic tables, cut into tasks that processes can do independently."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rtgs.base.json_records import to_json
from rtgs.config import SceneName, SynthConfig, SyntheticExperimentConfig
from rtgs.experiments.methods import METHODS, MI_WITHOUT_REPLAY, OUR_METHODS, by_ours, by_rendering, by_replay
from rtgs.experiments.records import ExperimentFolder
from rtgs.experiments.rivals import NGF_PYRAMID, RIVALS
from rtgs.experiments.trials import Trial, prepare
from rtgs.experiments.variants import FAR, FAR_SCENE, ROWS, Variant, groups


@dataclass(frozen=True)
class Task:
    """What one process does in one go: some rows of one trial by some methods."""

    scene: SceneName
    seed: int
    variants: tuple[Variant, ...]
    methods: tuple[str, ...]


def tasks_of(config: SyntheticExperimentConfig) -> list[Task]:
    """All the work behind a table, seed by seed, so that what is stopped early still has every scene."""
    tasks = []
    for table in config.tables:
        for seed in range(config.seeds):
            tasks += [Task(name, seed, ROWS[table], METHODS[table]) for name in config.scenes]
            if table == "beyond":
                tasks.append(Task(FAR_SCENE, seed, (FAR,), METHODS[table]))
        if table == "1":
            tasks += [Task(name, 0, ROWS[table], (MI_WITHOUT_REPLAY,)) for name in config.scenes]
    return tasks


def scene_config(config: SyntheticExperimentConfig, scene: SceneName) -> SynthConfig:
    """The capture that all trials of a scene share."""
    return SynthConfig(scene=scene, frames=config.frames, size=config.size, thermal_clean=False)


def folder_settings(config: SyntheticExperimentConfig) -> dict[str, object]:
    """What must agree for an earlier call's records to be kept."""
    return {"size": config.size, "frames": config.frames, "rgb": to_json(config.rgb)}


def missing_of(folder: ExperimentFolder, task: Task) -> list[tuple[Variant, str]]:
    """Rows and keys of the methods of a task that the folder has no record of."""
    return [(v, m) for v in task.variants for m in task.methods if not folder.has(task.scene, task.seed, v.key, m)]


def prepare_scene(out: str, config: SyntheticExperimentConfig, scene: SceneName) -> None:
    """Make what all trials of a scene share. out: the experiment's folder."""
    folder = ExperimentFolder(Path(out), folder_settings(config))
    prepare(folder.scene(scene), scene_config(config, scene), config.rgb)


def perform(out: str, config: SyntheticExperimentConfig, task: Task) -> None:
    """Make what is missing of a task's records. out: the experiment's folder."""
    folder = ExperimentFolder(Path(out), folder_settings(config))
    trial = Trial.read(folder.scene(task.scene), scene_config(config, task.scene), task.seed)
    for rows in groups(task.variants):
        missing = [(v, m) for v, m in missing_of(folder, task) if v in rows]
        if not missing:
            continue
        clean = trial.temperatures(rows[0].applied_to(trial.config).thermal_size)
        scenes = {v.key: trial.scene(v, clean) for v in rows}
        for variant, method in missing:
            if method in OUR_METHODS:
                folder.write(by_ours(OUR_METHODS[method], trial, variant, scenes[variant.key]))
            elif method == MI_WITHOUT_REPLAY:
                folder.write(by_rendering(trial, variant, scenes[variant.key]))
        # The paper's first: smooth losses are served by its renders.
        descents = [(v, r) for v, m in missing for r in RIVALS if r.key == m]
        descents.sort(key=lambda d: d[1] is not NGF_PYRAMID)
        for record in by_replay(trial, scenes, descents):
            folder.write(record)
