"""`rtgs experiment real`: the paper's Table III on any capture.

The RGB model is frozen. Each row places the thermal camera by another strategy. Then thermal colours are fitted to the training images, by
one solver with one set of settings, and held-out thermal images are scored where every row has pixels.
"""

from __future__ import annotations

import hashlib
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtgs import __version__
from rtgs.base.errors import RtgsError
from rtgs.base.events import Listener, ResultLine, long_work
from rtgs.base.json_records import to_json
from rtgs.base.progress import Progress
from rtgs.config import RealExperimentConfig, RunConfig
from rtgs.experiments.provenance import Provenance, command_line
from rtgs.experiments.real_results import write_results
from rtgs.experiments.real_rows import Row
from rtgs.experiments.real_scores import Scored, score
from rtgs.experiments.strategies import STRATEGIES, Given, Placement, Strategy
from rtgs.models import RgbModel
from rtgs.records.capture import Capture
from rtgs.records.scene import Scene
from rtgs.run.config_file import is_run, read_config
from rtgs.run.folder import RunFolder
from rtgs.run.pipeline import Pipeline
from rtgs.scale import ScaleEstimate
from rtgs.thermal import fit_thermal


def real_experiment(source: Path, out: Path, config: RealExperimentConfig, listener: Listener) -> list[Path]:
    """Make Table III of a run, or of a capture. A capture is run first, in `out`/run, with the settings found there or the defaults.

    A row that an earlier call made from the same inputs is not made again.

    Returns:
        The tables and pictures written.

    Raises:
        RtgsError: `source` or a setting cannot be used. A row that cannot run is no error: the tables say why.
    """
    config.check()
    own = out / "run"
    if is_run(source):
        opened = Pipeline.open(RunFolder(source), listener)
    else:
        opened = Pipeline.start(source, own, read_config(own).config if is_run(own) else RunConfig(), listener)
    with opened as pipeline:
        _check_names(config, pipeline.capture)
        pipeline.run("scale")
        folder = pipeline.folder
        # The rig as calibrated: a refined one belongs to the estimate alone, not to the other strategies.
        scene = folder.read_scene(pipeline.capture, refined=False)
        rgb, estimate = folder.read_rgb(), folder.read_scale()
    return compare(scene, rgb, estimate, out, config, listener)


def compare(
    scene: Scene, rgb_model: RgbModel, estimate: ScaleEstimate, out: Path, config: RealExperimentConfig, listener: Listener
) -> list[Path]:
    """Make Table III of what is in memory.

    Args:
        scene: with its rig as calibrated.
        estimate: of this package; a refined rig is in it.
        out: folder of the tables, pictures and rows; rows of earlier calls are kept there.

    Returns, raises: as `real_experiment`.
    """
    config.check()
    _check_names(config, scene.capture)
    held_out = [f.name for f in scene.held_out_frames]
    if config.region_frame is not None and config.region_frame not in held_out:
        raise RtgsError(f"--region-frame {config.region_frame}: is no held-out frame; they are {', '.join(held_out)}.")
    if not scene.held_out_frames or not scene.train_frames:
        raise RtgsError("experiment real: training frames and held-out frames are needed, and one kind has no registered frame.")
    given = Given(scene, rgb_model, estimate, config)
    common = _fingerprint(given)
    rows = [_row(strategy, given, common, out, listener) for strategy in STRATEGIES]
    with long_work(listener, "scores", "scores and pictures") as progress:
        scored = score(scene, rows, config, progress)
        provenance = Provenance.of(command_line("rtgs experiment real CAPTURE --out DIR", config, RealExperimentConfig()))
        files = write_results(out, scene, rows, scored, _notes(given, scored), provenance, progress)
    for line in scored.lines():
        listener(ResultLine(line))
    return files


def _row(strategy: Strategy, given: Given, common: str, out: Path, listener: Listener) -> Row:
    """The row as an earlier call left it, or made now; without images where the strategy cannot run."""
    key = hashlib.sha256(f"{common} {strategy.key} {strategy.inputs(given)}".encode()).hexdigest()
    path = out / "rows" / f"{strategy.key}.npz"
    row = Row.read(path, strategy.title, key)
    if row is not None:
        listener(ResultLine(f"{strategy.title}: done before"))
        return row
    with long_work(listener, strategy.key, strategy.title) as progress:
        start = time.perf_counter()
        try:
            placement = strategy.place(given, progress)
        except RtgsError as error:
            listener(ResultLine(f"{strategy.title}: not run, {error}"))
            return Row(strategy.key, strategy.title, None, {}, why=str(error))
        images = _images(given, placement, progress)
    row = Row(strategy.key, strategy.title, placement.sfm_per_metre, images, seconds=time.perf_counter() - start)
    row.write(path, key)
    return row


def _images(given: Given, placement: Placement, progress: Progress) -> dict[str, NDArray[np.float32]]:
    """Thermal colours fitted to the training images, seen from the held-out frames' thermal cameras.

    Returns:
        Held-out frame → `[h, w]` °C (or counts), NaN where the row has no pixel.
    """
    scene, sfm_per_metre = placement.scene, 1.0 if placement.sfm_per_metre is None else placement.sfm_per_metre
    model = fit_thermal(scene, given.rgb_model, sfm_per_metre, given.config.thermal, progress=progress)
    images = {}
    for frame in scene.held_out_frames:
        pose = scene.thermal_from_world(frame.name, sfm_per_metre)
        view = model.render(scene.rig.thermal, pose, photographed_in=frame.name)
        images[frame.name] = placement.in_thermal(np.where(scene.capture.thermal_mask, view, np.float32(np.nan)))
    return images


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


def _fingerprint(given: Given) -> str:
    """A hash of what every row depends on: images, poses, rig, RGB model, settings of the thermal fit."""
    scene, rgb_model, config = given.scene, given.rgb_model, given.config
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


def _notes(given: Given, scored: Scored) -> list[str]:
    scene, estimate, thermal = given.scene, given.estimate, given.config.thermal
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
