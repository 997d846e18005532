"""Score the models on held-out views, and draw what a person should see."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rtgs.base.progress import Progress
from rtgs.evaluation.records import Evaluation, ModelScores, Scores
from rtgs.images.filters import GRAY_WEIGHTS
from rtgs.images.pictures import edge_overlay, error_map, palette, save_png, to_picture
from rtgs.metrics.basic import mae, psnr, ssim_index
from rtgs.metrics.lpips import SMALLEST_PX, Lpips
from rtgs.metrics.peaks import peak_errors
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene

RGB_ERROR_LIMIT = 0.25
THERMAL_ERROR_SHARE = 0.2  # of the range


def evaluate(
    scene: Scene,
    rgb_model: RgbModel,
    thermal_model: ThermalModel,
    naive_model: ThermalModel | None = None,
    *,
    lpips: Lpips | None = None,
    renders: Path | None = None,
    start: Scene | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Score the models on the held-out frames: PSNR, SSIM, LPIPS, temperature error, and error of peaks.

    Nothing is fitted to a held-out frame. Where the thermal model has drift, a render gets the drift that the frames beside it let
    expect (`ThermalModel.drift_of`). Thermal PSNR, SSIM and LPIPS are computed in the fixed range of the training images
    (`LinearRange`), on valid pixels. LPIPS compares them as gray pictures, clipped to the range.

    Args:
        naive_model: the control, fitted at `sfm_per_metre` = 1.
        lpips: the network. Without it, and for images under 32 px a side, no LPIPS is computed.
        renders: a folder for pictures: reference, render and error of each view, and the edge overlays at scale 1 and at the
            recovered scale.
        start: where the search for the rig began, if it was found from the capture: the overlays before are then those of this rig, with
            both cameras in the same place, since no baseline was known.
        progress: called with (frames done, frames in all, the frame's name).

    Returns:
        Means and per-frame scores. Without held-out frames no model has a score.
    """
    frames, capture, rig = scene.held_out_frames, scene.capture, scene.rig
    thermal_models = {"thermal": thermal_model} | ({"thermal_naive": naive_model} if naive_model is not None else {})
    scores: dict[str, dict[str, Scores]] = {key: {} for key in ("rgb", *thermal_models)}
    for done, frame in enumerate(frames):
        view = rgb_model.render(rig.rgb, scene.rgb_from_world(frame.name))
        scores["rgb"][frame.name] = Scores(**_likeness(view, frame.rgb, capture.rgb_mask, lpips))
        if renders is not None:
            save_png(renders / "rgb" / f"{frame.name}.reference.png", to_picture(frame.rgb))
            save_png(renders / "rgb" / f"{frame.name}.render.png", to_picture(view))
            save_png(renders / "rgb" / f"{frame.name}.error.png", error_map(view, frame.rgb, RGB_ERROR_LIMIT))
        for key, model in thermal_models.items():
            pose = scene.thermal_from_world(frame.name, model.sfm_per_metre)
            temperature = model.render(rig.thermal, pose, photographed_in=frame.name)
            scores[key][frame.name] = _thermal_scores(temperature, frame.thermal, scene, model, lpips)
            if renders is not None:
                _draw_thermal(renders / key, frame, temperature, scene, model)
        if renders is not None:
            _draw_overlays(renders / "overlay", frame, scene, rgb_model, thermal_model, start)
        if progress is not None:
            progress(done + 1, len(frames), frame.name)
    models = {key: ModelScores.of(per_frame) for key, per_frame in scores.items()}
    span, celsius = (thermal_model.range.lo, thermal_model.range.hi), thermal_model.unit == "°C"
    return Evaluation(
        models["rgb"],
        models["thermal"],
        models.get("thermal_naive"),
        temperature_range_c=span if celsius else None,
        count_range=None if celsius else span,
    )


def _likeness(view: np.ndarray, reference: np.ndarray, mask: np.ndarray, lpips: Lpips | None) -> dict[str, float]:
    found = {"psnr": psnr(view, reference, mask=mask), "ssim": ssim_index(view, reference, mask=mask)}
    if lpips is not None and min(mask.shape) >= SMALLEST_PX:
        found["lpips"] = lpips(view, reference, mask=mask)
    return found


def _thermal_scores(
    temperature: np.ndarray, reference: np.ndarray, scene: Scene, model: ThermalModel, lpips: Lpips | None
) -> Scores:
    mask = scene.capture.thermal_mask
    likeness = _likeness(model.range.normalise(temperature), model.range.normalise(reference), mask, lpips)
    return Scores(**likeness, **temperature_scores(temperature, reference, mask, scene.capture.radiometry.suffix))


def temperature_scores(render: np.ndarray, photograph: np.ndarray, mask: np.ndarray, suffix: str) -> dict[str, float]:
    """Mean error of a thermal render, and its error at the photograph's strongest small extremes, where it has any.

    Args:
        suffix: "c" or "counts": how the scores' names end.
    """
    found, errors = {f"mae_{suffix}": mae(render, photograph, mask=mask)}, peak_errors(render, photograph, mask=mask)
    if len(errors):
        found |= {f"peak_{suffix}": float(errors.mean()), f"peak_p90_{suffix}": float(np.percentile(errors, 90))}
    return found


def _draw_thermal(folder: Path, frame: Frame, temperature: np.ndarray, scene: Scene, model: ThermalModel) -> None:
    """Reference, render and error of one view; invalid pixels of the sensor are gray."""
    reference = np.where(scene.capture.thermal_mask, frame.thermal, np.nan)
    lo, hi = model.range.lo, model.range.hi
    save_png(folder / f"{frame.name}.reference.png", palette(reference, lo, hi))
    save_png(folder / f"{frame.name}.render.png", palette(temperature, lo, hi))
    save_png(folder / f"{frame.name}.error.png", error_map(temperature, reference, THERMAL_ERROR_SHARE * (hi - lo), model.unit))


def _draw_overlays(
    folder: Path, frame: Frame, scene: Scene, rgb_model: RgbModel, thermal_model: ThermalModel, start: Scene | None
) -> None:
    """Edges of the RGB model, seen from the thermal camera, on those of the thermal image: before and after."""
    thermal = thermal_model.range.normalise(frame.thermal)
    before = (scene, 1.0) if start is None else (start, 0.0)
    for when, (placed, sfm_per_metre) in (("before", before), ("after", (scene, thermal_model.sfm_per_metre))):
        pose = placed.thermal_from_world(frame.name, sfm_per_metre)
        gray = rgb_model.render(placed.rig.thermal, pose) @ np.array(GRAY_WEIGHTS, np.float32)
        save_png(folder / f"{frame.name}.{when}.png", edge_overlay(gray, thermal, scene.capture.thermal_mask))
