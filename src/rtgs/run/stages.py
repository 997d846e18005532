"""The stages of a run, in one table. Light to import: the work of a stage imports what it needs when it begins."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from rtgs.base.events import ModelSnapshot
from rtgs.base.json_records import to_json
from rtgs.config import RunConfig

if TYPE_CHECKING:
    from rtgs.base.progress import Progress
    from rtgs.models import RgbModel, ThermalModel
    from rtgs.run.content import Content
    from rtgs.run.job import Job

StageName: TypeAlias = Literal["sfm", "rgb", "scale", "thermal", "spots", "evaluate"]


@dataclass(frozen=True)
class Stage:
    """One stage of a run.

    Attributes:
        name: in `stages.json`, in events and on the command line.
        title: for people.
        settings: the part of a run's settings that its result depends on.
        inputs: the part of the capture's content that its result depends on, beside what the stages before it depend on.
        work: does it, from what the stages before it have left in the run folder.
        makes: files and folders in the run folder that it leaves there.
        may_make: likewise, depending on the capture.
        sees_refined_rig: the rig as the scale stage has refined it; else as calibrated.
        half_done: files from which work that was cut off goes on.
        parts: further pieces of work with their titles, which are timed by themselves.
    """

    name: StageName
    title: str
    settings: Callable[[RunConfig], Any]
    inputs: Callable[[Content], Any]
    work: Callable[[Job], None]
    makes: tuple[str, ...]
    may_make: tuple[str, ...] = ()
    half_done: tuple[str, ...] = ()
    sees_refined_rig: bool = False
    parts: Mapping[str, str] = field(default_factory=dict)


def _find_poses(job: Job) -> None:
    from rtgs.sfm.poses import run_sfm

    with job.work("sfm", TITLES["sfm"]) as progress, job.work_files("sfm") as folder:
        scene = run_sfm(job.capture, job.config.sfm, work_dir=folder, progress=progress)
    job.results.write_scene(scene, None)
    job.results.write_summary(scene)
    job.say(f"sfm: {len(scene.frames)} of {len(job.capture.frames)} frames registered, {len(scene.points):,} points")
    for v in scene.capture.found_rgb.values if scene.capture.found_rgb else []:
        job.say(f"  rgb.{v.name}: {v.found:.6g}{'' if v.std is None else f' ± {v.std:.2g}'} (assumed: {v.assumed:.6g})")
    for name, reason in scene.failures.items():
        job.say(f"  {name}: {reason}")
    for warning in scene.capture.warnings[len(job.capture.warnings) :]:
        job.warn(warning)


def _make_rgb_model(job: Job) -> None:
    from rtgs.records.world import given_from_world, is_far
    from rtgs.rgb.imported import import_model
    from rtgs.rgb.train import fit_rgb

    scene, ply = job.scene, job.config.rgb_ply
    if is_far(given_from_world(scene.world_from_rgb.values())):
        job.warn(
            "scene/ is of an earlier version, whose models are not exact so far from the origin. Remove the folder scene/ of the run, and "
            "run again: then all stages are done anew, about the middle of the cameras."
        )

    def snapshot(step: int, model: RgbModel) -> None:
        job.listener(ModelSnapshot("rgb", step, model))

    if ply is not None:
        with job.work("rgb", "import of the RGB model"):
            model, likeness = import_model(ply, scene, job.config.rgb)
        told = f", {likeness.psnr:.2f} dB on training photographs"
    else:
        with job.work("rgb", TITLES["rgb"]) as progress:
            model = fit_rgb(
                scene, job.config.rgb, checkpoint=job.folder.checkpoint, progress=progress, snapshot=snapshot, memory=job.memory
            )
        held_out = model.history.get("held_out_psnr")
        told = f", held-out PSNR {held_out[-1]:.2f} dB" if held_out else ""
    job.results.write_rgb(model, scene.given_from_world)
    job.say(f"rgb: {len(model.gaussians):,} Gaussians{told}")


def _find_scale(job: Job) -> None:
    from rtgs.metres import find_metres
    from rtgs.run.summary import metres_lines
    from rtgs.scale import estimate_scale

    scene, model = job.scene, job.folder.read_rgb()
    with job.work("scale", TITLES["scale"]) as progress:
        estimate = estimate_scale(scene, model, job.config.scale, progress=progress)
        found = find_metres(estimate.refined_scene(scene), estimate, job.config.metres, progress=progress)
    estimate = replace(estimate, metres=found.metres)
    if found.metres.disagreement:
        job.warn(found.metres.disagreement)  # before anything else
    job.results.write_scale(estimate)
    if found.georeference is not None:
        job.results.write_georeference(found.georeference)
    job.results.write_scene(estimate.refined_scene(scene), estimate.sfm_per_metre)
    interval = f" (95 %: {estimate.ci95[0]:.5g} to {estimate.ci95[1]:.5g})" if estimate.ci95 else ""
    per = "metre" if estimate.calibration is None or estimate.baseline_m is not None else "baseline"
    seen = estimate.calibration is None or estimate.calibration.baseline_seen
    job.say(
        f"scale: {f'{estimate.sfm_per_metre:.5g} SfM units per {per}{interval}' if seen else 'no baseline'}, {estimate.status}"
    )
    if estimate.no_metres or estimate.reason:
        job.warn(estimate.no_metres or estimate.reason)
    for f in estimate.refinement.freedoms if estimate.refinement else []:
        known = "" if f.decided else ", which the images do not decide"
        job.say(f"  {f.name}: {f.mean:+.3g} ± {f.std:.2g} {f.unit} (calibration: ± {f.prior_std:.2g}){known}")
    for line in metres_lines(found.metres):
        job.say(line)


def _fit_temperatures(job: Job) -> None:
    from rtgs.thermal import fit_thermal, gaussian_temperatures

    scene, rgb, config = job.scene, job.folder.read_rgb(), job.config.thermal
    scale = job.folder.read_scale()

    def fit(at: float, progress: Progress) -> ThermalModel:
        return fit_thermal(scene, rgb, at, config, progress=progress, memory=job.memory)

    with job.work("thermal", TITLES["thermal"]) as progress:
        model = fit(scale.sfm_per_metre, progress)
        model = replace(model, temperatures=gaussian_temperatures(scene, model, progress=progress, memory=job.memory))
    job.results.write_thermal(model, scene.given_from_world)
    if scale.no_control:
        job.say(f"thermal: {scale.no_control}")
    else:
        with job.work("thermal_naive", TITLES["thermal_naive"]) as progress:
            naive = fit(1.0, progress)
        job.results.write_thermal(naive, scene.given_from_world, "thermal_naive")
    job.say(f"thermal: {len(model.gaussians):,} Gaussians with a temperature")


def _list_spots(job: Job) -> None:
    from rtgs.config import SpotsConfig
    from rtgs.run.spots import list_spots

    with job.work("spots", TITLES["spots"]) as progress:
        if job.scene.capture.radiometry.unit == "counts":  # what a spot is in °C is noise in counts
            job.say("spots: none listed, the capture has no temperatures; `rtgs spots --excess` takes counts")
            return
        found = list_spots(job.folder, job.scene, job.results.path / "spots", SpotsConfig(), progress=progress)
    job.say(f"spots: {len(found.spots)} ({found.criterion})")


def _score_held_out_views(job: Job) -> None:
    from rtgs.evaluation.held_out import evaluate
    from rtgs.metrics.lpips import available
    from rtgs.run.summary import metric_lines

    folder, scene = job.folder, job.scene
    rgb, thermal = folder.read_rgb(), folder.read_thermal()
    naive = folder.read_thermal("thermal_naive") if (folder.path / "thermal_naive.ply").exists() else None
    networks, notes = available(["alexnet"])
    lpips = networks.get("alexnet")
    start = None if folder.read_scale().calibration is None else folder.read_scene(job.capture, refined=False)
    with job.work("evaluate", TITLES["evaluate"]) as progress:
        scores = evaluate(scene, rgb, thermal, naive, lpips=lpips, renders=job.results.renders, start=start, progress=progress)
    scores = replace(scores, notes=tuple(notes), timings_s={**folder.seconds(), **job.seconds})
    scores.write(job.results.path / "metrics.json")
    for line in metric_lines(scores):
        job.say(line)


STAGES: tuple[Stage, ...] = (
    Stage(
        name="sfm",
        title="structure from motion",
        settings=lambda config: [config.rgb_max_side, config.sfm],
        inputs=lambda content: [content.files, content.cameras],
        work=_find_poses,
        makes=("scene", "capture_summary.json"),
    ),
    Stage(
        name="rgb",
        title="RGB model",
        settings=lambda config: config.rgb,
        inputs=lambda content: content.rgb_ply,
        work=_make_rgb_model,
        makes=("rgb.ply", "rgb.json"),
        half_done=("rgb.checkpoint",),
    ),
    Stage(
        name="scale",
        title="metric scale",
        settings=lambda config: [config.scale, config.metres],
        inputs=lambda content: [content.radiometry, content.metres],
        work=_find_scale,
        makes=("scale.json",),
        may_make=("georeference.json",),
    ),
    Stage(
        name="thermal",
        title="thermal model",
        settings=lambda config: config.thermal,
        inputs=lambda content: None,
        work=_fit_temperatures,
        makes=("thermal.ply", "thermal.json"),
        may_make=("thermal_naive.ply", "thermal_naive.json", "thermal_pattern.tiff", "thermal_naive_pattern.tiff"),
        sees_refined_rig=True,
        parts={"thermal_naive": "control: thermal model at scale 1"},
    ),
    Stage(
        name="spots",
        title="hot and cold spots",
        settings=lambda config: None,
        inputs=lambda content: None,
        work=_list_spots,
        makes=(),
        may_make=("spots",),
        sees_refined_rig=True,
    ),
    Stage(
        name="evaluate",
        title="held-out views",
        settings=lambda config: None,
        inputs=lambda content: None,
        work=_score_held_out_views,
        makes=("metrics.json",),
        may_make=("renders",),
        sees_refined_rig=True,
    ),
)

TITLES: dict[str, str] = {name: title for s in STAGES for name, title in {s.name: s.title, **s.parts}.items()}
"""Titles of all pieces of work of a run, in their order."""


def not_made(run: Path) -> dict[StageName, list[str]]:
    """What each stage leaves in a run folder and is not there; stages without such are left out."""
    found = {stage.name: [made for made in stage.makes if not (run / made).exists()] for stage in STAGES}
    return {name: files for name, files in found.items() if files}


def fingerprints(content: Content, config: RunConfig, stages: Sequence[Stage] = STAGES) -> dict[StageName, str]:
    """What each stage's result depends on, as a hash chained from stage to stage."""
    chain, result = "", {}
    for stage in stages:
        own = json.dumps(to_json([stage.settings(config), stage.inputs(content)]))
        chain = hashlib.sha256((chain + own).encode()).hexdigest()[:16]
        result[stage.name] = chain
    return result
