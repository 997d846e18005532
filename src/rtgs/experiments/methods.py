"""The methods of the synthetic experiment: which of them each table has, and what each makes of a trial."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rtgs.config import ScaleConfig, SyntheticTable
from rtgs.experiments.ablation import ABLATION
from rtgs.experiments.curves import Curves, replay
from rtgs.experiments.records import Record
from rtgs.experiments.rivals import INERF_L1, MUTUAL_INFORMATION, NGF_PYRAMID, OURS, OURS_REFINED, RIVALS, OurMethod, Rival
from rtgs.experiments.trials import Trial
from rtgs.experiments.variants import Variant
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.scale import Objective, ScaleEstimate
from rtgs.scale.adam import descend_by_adam
from rtgs.scale.bracket import flow_per_unit
from rtgs.scale.objective import scaled_thermal

PAPER = ScaleConfig(solver="adam")  # 200 steps at 5e-3, all frames
WIDEST_PIXEL = 0.03  # of s: what stands for a pixel of flow where s hardly flows
SETTLED_SHARE = 0.005  # of s: a descent that stays this close to its last step has settled
OUR_METHODS = {method.key: method for method in (OURS, OURS_REFINED, *ABLATION)}
MI_WITHOUT_REPLAY = f"{MUTUAL_INFORMATION.key}_run"  # Adam that renders at every step, to check a replay
METHODS: dict[SyntheticTable, tuple[str, ...]] = {
    "1": (*(r.key for r in RIVALS), OURS.key),
    "2": (INERF_L1.key, NGF_PYRAMID.key, OURS.key, OURS_REFINED.key),
    "beyond": (INERF_L1.key, NGF_PYRAMID.key, OURS.key),
    "ablation": (OURS.key, *(method.key for method in ABLATION)),
}
"""Table → keys of its methods, in the order of its columns or lines."""


def by_ours(own: OurMethod, trial: Trial, variant: Variant, scene: Scene) -> Record:
    """This package's own answer to a row."""
    started = time.process_time()
    estimate = own(_reduced(scene, variant), trial.model)
    seconds = time.process_time() - started
    return _record(
        trial,
        variant,
        own.key,
        estimate.sfm_per_metre,
        iterations=len(estimate.history.step),
        renders=estimate.renders,
        seconds=seconds,
        half_width_pct=_half_width_pct(estimate),
        status=estimate.status,
    )


def by_rendering(trial: Trial, variant: Variant, scene: Scene) -> Record:
    """The paper's Adam on mutual information, rendering at every step."""
    objective = MUTUAL_INFORMATION.objective(_pictures(trial, scene), normalised_thermal(scene), scene.capture.thermal_mask)
    started = time.process_time()
    path = descend_by_adam(objective, math.log(trial.start), PAPER)
    seconds = time.process_time() - started
    return _record(
        trial,
        variant,
        MI_WITHOUT_REPLAY,
        math.exp(path.theta),
        iterations=_iterations(path.history.sfm_per_metre),
        renders=PAPER.steps * len(objective.frames),
        seconds=seconds,
    )


def _pictures(trial: Trial, scene: Scene) -> Objective:
    """What descents render: of all training frames."""
    return Objective(scene, trial.model, scene.train_frames, EdgeLoss())


def by_replay(trial: Trial, scenes: dict[str, Scene], descents: Sequence[tuple[Variant, Rival]]) -> Iterator[Record]:
    """The paper's Adam on other losses, for rows that share their cameras, on curves rendered once.

    Args:
        scenes: key of a row → its scene.
    """
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
            variant,
            rival.key,
            math.exp(path.theta) / factor,
            iterations=_iterations(path.history.sfm_per_metre),
            renders=renders,
            seconds=renders * curves.seconds_each(key),
        )


def _record(trial: Trial, variant: Variant, method: str, found: float, **more: object) -> Record:
    def error(factor: float) -> float:
        return 100 * abs(found * factor / trial.truth - 1)

    values = {"error_pct": error(1.0), "product_error_pct": error(variant.length_factor), **more}
    return Record(trial.config.scene, trial.config.rig_seed, variant.key, method, trial.truth, trial.start, found, **values)  # type: ignore[arg-type]


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
