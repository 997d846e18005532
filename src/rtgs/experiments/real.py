"""`rtgs experiment real`: the paper's Table III on any capture.

The RGB model is frozen. Each row says where the thermal camera is in its own way; then new thermal harmonics are fitted to the training
images, by one solver with one set of settings, and held-out thermal images are scored where every row has pixels.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rtgs import __version__
from rtgs.base.errors import RtgsError
from rtgs.base.json_records import to_json
from rtgs.base.progress import Progress
from rtgs.config import RealExperimentConfig, RunConfig
from rtgs.experiments.real_table import Row, Scored, score, write_results
from rtgs.experiments.strategies.manual import manual_scale
from rtgs.experiments.strategies.metric_depth import ABSENT as DEPTH_ABSENT
from rtgs.experiments.strategies.metric_depth import load_depth_model, scale_from_depth
from rtgs.experiments.strategies.metric_poses import ABSENT as MAST3R_ABSENT
from rtgs.experiments.strategies.metric_poses import load_mast3r, scale_from_pairs
from rtgs.experiments.strategies.planar import PlanarScene
from rtgs.io.colmap import read_scene
from rtgs.models import RgbModel
from rtgs.records.capture import Capture
from rtgs.records.scene import Scene
from rtgs.run.config_file import is_run, read_config
from rtgs.run.pipeline import Pipeline, Reporter, RunFolder
from rtgs.scale import ScaleEstimate
from rtgs.thermal import fit_thermal

Images = dict[str, NDArray[np.float32]]
"""Held-out frame → `[h, w]` °C (or counts), NaN where a row has no pixel."""


def real_experiment(source: Path, out: Path, config: RealExperimentConfig, reporter: Reporter) -> list[Path]:
    """Table III of a run, or of a capture, which is run first (to `out`/run: with the defaults, or its own settings if it is there).

    A row that stands from an earlier call with the same inputs is not made again.

    Returns:
        The tables and pictures written.

    Raises:
        RtgsError: `source` or a setting cannot be used. A row that cannot run is no error: the tables say why.
    """
    config.check()
    if is_run(source):
        pipeline = Pipeline(RunFolder(source), reporter)
    else:
        own = out / "run"
        pipeline = Pipeline.start(source, own, read_config(own)[1] if is_run(own) else RunConfig(), reporter)
    _check_names(config, pipeline.capture)
    pipeline.run("scale")
    folder = pipeline.folder
    scene = read_scene(folder.path / "scene", pipeline.capture)  # a refined rig is the estimate's alone, and none of the rivals'
    return compare(scene, folder.read_rgb(), folder.read_scale(), out, config, reporter)


def compare(
    scene: Scene, rgb_model: RgbModel, estimate: ScaleEstimate, out: Path, config: RealExperimentConfig, reporter: Reporter
) -> list[Path]:
    """The same for what is in memory: the scene with its rig as calibrated. `real_experiment` has the details."""
    config.check()
    _check_names(config, scene.capture)
    held_out = [f.name for f in scene.held_out_frames]
    if config.region_frame is not None and config.region_frame not in held_out:
        raise RtgsError(f"--region-frame {config.region_frame}: is no held-out frame; they are {', '.join(held_out)}.")
    if not scene.held_out_frames or not scene.train_frames:
        raise RtgsError("bench real: training frames and held-out frames are needed, and one kind has no registered frame.")
    common = _fingerprint(scene, rgb_model, config)
    rows = []
    for strategy in strategies(scene, rgb_model, estimate, config):
        key = hashlib.sha256(f"{common} {strategy.key} {strategy.inputs}".encode()).hexdigest()
        path = out / "rows" / f"{strategy.key}.npz"
        row = Row.read(path, strategy.title, key)
        if row is not None:
            reporter.say(f"{strategy.title}: done before")
        else:
            try:
                with reporter.stage(strategy.title) as progress:
                    start = time.perf_counter()
                    sfm_per_metre, images = strategy.work(progress)
                row = Row(strategy.key, strategy.title, sfm_per_metre, images, seconds=time.perf_counter() - start)
                row.write(path, key)
            except NotHere as error:
                row = Row(strategy.key, strategy.title, None, {}, why=str(error))
                reporter.say(f"{strategy.title}: not run, {error}")
        rows.append(row)
    with reporter.stage("scores and pictures") as progress:
        scored = score(scene, rows, config, progress)
        files = write_results(out, scene, rows, scored, _notes(scene, estimate, config, scored), progress)
    for line in scored.lines():
        reporter.say(line)
    return files


class NotHere(Exception):
    """A row that cannot run, and why."""


@dataclass(frozen=True)
class Strategy:
    """One row to be made: `work` gives its scale (None: it has none) and its held-out images; `inputs` is what they depend on beside the
    scene, the RGB model and the settings of the thermal fit.

    `work` raises `NotHere`.
    """

    key: str
    title: str
    inputs: Any
    work: Callable[[Progress], tuple[float | None, Images]]


def strategies(scene: Scene, rgb_model: RgbModel, estimate: ScaleEstimate, config: RealExperimentConfig) -> Sequence[Strategy]:
    """The rows in the paper's order."""

    def at(find: Callable[[Progress], float], scene: Scene = scene) -> Callable[[Progress], tuple[float, Images]]:
        def work(progress: Progress) -> tuple[float, Images]:
            try:
                sfm_per_metre = find(progress)
            except RtgsError as error:
                raise NotHere(str(error)) from error
            return sfm_per_metre, _fitted(scene, rgb_model, sfm_per_metre, config, progress)

        return work

    def mast3r(progress: Progress) -> float:
        if config.mast3r_weights is None:
            raise NotHere(MAST3R_ABSENT)
        return scale_from_pairs(scene, load_mast3r(config.mast3r_weights), progress=progress)

    def depth(progress: Progress) -> float:
        if config.depth_model is None:
            raise NotHere(DEPTH_ABSENT)
        return scale_from_depth(scene, rgb_model, load_depth_model(config.depth_model), progress=progress)

    def planar(progress: Progress) -> tuple[None, Images]:
        try:
            warped = PlanarScene.of(scene, config.plane_m)
        except RtgsError as error:
            raise NotHere(str(error)) from error
        fitted = _fitted(warped.scene, rgb_model, 1.0, config, progress)
        return None, {name: warped.warped_back(image) for name, image in fitted.items()}

    found, manual = estimate.sfm_per_metre, config.manual
    refined = None if estimate.refinement is None else asdict(estimate.refinement)
    return (
        Strategy("manual", "Manual", to_json(manual), at(lambda _: manual_scale(scene, manual))),
        Strategy("naive", "Naive", None, at(lambda _: 1.0)),
        Strategy("mast3r", "MASt3R", _files(config.mast3r_weights), at(mast3r)),
        Strategy("depth", "Metric depth", _files(config.depth_model), at(depth)),
        Strategy("planar", "Planar", config.plane_m, planar),
        Strategy("ours", "Ours", (found, refined), at(lambda _: found, estimate.refined_scene(scene))),
    )


def _fitted(scene: Scene, rgb_model: RgbModel, sfm_per_metre: float, config: RealExperimentConfig, progress: Progress) -> Images:
    """Thermal harmonics fitted to the training images, seen from the held-out frames' thermal cameras."""
    model = fit_thermal(scene, rgb_model, sfm_per_metre, config.thermal, progress=progress)
    mask = scene.capture.thermal_mask

    def image(name: str) -> NDArray[np.float32]:
        view = model.render(scene.rig.thermal, scene.thermal_from_world(name, sfm_per_metre), photographed_in=name)
        return np.where(mask, view, np.float32(np.nan))

    return {f.name: image(f.name) for f in scene.held_out_frames}


def _check_names(config: RealExperimentConfig, capture: Capture) -> None:
    """Refuse what the capture does not have before any long work."""
    names = [f.name for f in capture.frames]
    for flag, name in [("--manual.frames", n) for n in config.manual.frames or ()] + [("--region-frame", config.region_frame)]:
        if name is not None and name not in names:
            raise RtgsError(f"{flag}: the capture has no frame {name!r}; its frames are {', '.join(names[:3])}, …")
    if config.region is not None:
        left, top, right, bottom = config.region
        camera = capture.rig.thermal
        if not (0 <= left < right <= camera.width and 0 <= top < bottom <= camera.height):
            raise RtgsError(
                f"--region {left} {top} {right} {bottom}: is left, top, right and bottom within {camera.width} × {camera.height} pixels."
            )


def _fingerprint(scene: Scene, rgb_model: RgbModel, config: RealExperimentConfig) -> str:
    """Of what every row depends on: pictures, poses, rig, RGB model, settings of the fit."""
    digest = hashlib.sha256()
    for array in (t.detach().numpy() for t in (*rgb_model.gaussians.tensors().values(), rgb_model.background)):
        digest.update(np.ascontiguousarray(array).tobytes())
    for frame in scene.frames:
        digest.update(frame.name.encode() + scene.world_from_rgb[frame.name].matrix().tobytes())
        digest.update(frame.rgb.tobytes() + frame.thermal.tobytes())
    digest.update(scene.capture.thermal_mask.tobytes() + scene.capture.rgb_mask.tobytes())
    rig = scene.rig
    digest.update(repr((rig.rgb, rig.thermal, rig.rgb_from_thermal.matrix().tolist(), rgb_model.settings)).encode())
    digest.update(repr((__version__, [f.name for f in scene.held_out_frames], to_json(config.thermal))).encode())
    return digest.hexdigest()


def _files(path: Path | None) -> Any:
    """Sizes and times of a model's files: another model is another row."""
    if path is None:
        return None
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    return [(str(p), p.stat().st_size, p.stat().st_mtime_ns) for p in files]


def _notes(scene: Scene, estimate: ScaleEstimate, config: RealExperimentConfig, scored: Scored) -> list[str]:
    thermal = config.thermal
    interval = f", 95 % interval {estimate.ci95[0]:.5g} to {estimate.ci95[1]:.5g}" if estimate.ci95 else ""
    notes = [
        f"{len(scene.train_frames)} training and {len(scene.held_out_frames)} held-out frames. Geometry, opacity, RGB colours and poses "
        f"frozen; every row by the thermal solver `{thermal.solver}`, drift `{thermal.drift}`, harmonics of degree {thermal.sh_degree}.",
        f"Scored on the {scored.share:.1%} of the thermal image where every row has pixels; PSNR, SSIM and LPIPS in the range "
        f"{scored.lo:.2f} to {scored.hi:.2f} {scored.unit} of the training images.",
        f"Ours: solver `{estimate.solver}`{', calibration refined' if estimate.refinement else ''}, {estimate.status}{interval}.",
    ]
    if scored.region_note:
        notes.append(scored.region_note)
    return notes + scored.missing
