"""Score the models on held-out views, and draw what a person should see."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from rtgs.base.progress import Progress
from rtgs.images.filters import GRAY_WEIGHTS
from rtgs.images.pictures import edge_overlay, error_map, palette, save_png, to_picture
from rtgs.metrics.basic import mae, psnr, ssim_index
from rtgs.metrics.lpips import SMALLEST_PX, Lpips
from rtgs.models import RgbModel, ThermalModel
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
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Held-out PSNR, SSIM, LPIPS and temperature error.

    Nothing is fitted to a held-out frame. Where the model has drift, a render gets what the frames beside it let expect
    (`ThermalModel.drift_of`). Thermal PSNR, SSIM and LPIPS are in the fixed range of the training images (`LinearRange`), on
    valid pixels; LPIPS sees them as gray pictures, clipped to the range.

    Args:
        naive_model: the control, fitted at `sfm_per_metre` = 1.
        lpips: without it, and for images under 32 px a side, there is no LPIPS.
        renders: a folder for pictures: reference, render and error of each view, and the edge overlays at scale 1 and at the
            recovered scale.

    Returns:
        {"rgb": {"psnr", "ssim", "lpips", "per_frame"}, "thermal": {"psnr", "ssim", "lpips", "mae_c", "per_frame"},
        "thermal_naive": likewise, "temperature_range_c": [lo, hi]}; a relative capture has "mae_counts" and "count_range" instead.
        Without held-out frames the scores are absent.
    """
    frames = scene.held_out_frames
    unit = "c" if scene.capture.thermal_unit == "celsius" else "counts"
    thermal_models = {"thermal": thermal_model} | ({"thermal_naive": naive_model} if naive_model is not None else {})
    scores: dict[str, dict[str, dict[str, float]]] = {key: {} for key in ("rgb", *thermal_models)}
    for done, frame in enumerate(frames):
        view = rgb_model.render(scene.rig.rgb, scene.rgb_from_world(frame.name))
        mask = scene.capture.rgb_mask
        scores["rgb"][frame.name] = _likeness(view, frame.rgb, mask, lpips)
        if renders is not None:
            save_png(renders / "rgb" / f"{frame.name}.reference.png", to_picture(frame.rgb))
            save_png(renders / "rgb" / f"{frame.name}.render.png", to_picture(view))
            save_png(renders / "rgb" / f"{frame.name}.error.png", error_map(view, frame.rgb, RGB_ERROR_LIMIT))
        mask = scene.capture.thermal_mask
        for key, model in thermal_models.items():
            pose = scene.thermal_from_world(frame.name, model.sfm_per_metre)
            temperature = model.render(scene.rig.thermal, pose, photographed_in=frame.name)
            a, b = model.range.normalise(temperature), model.range.normalise(frame.thermal)
            scores[key][frame.name] = {
                **_likeness(a, b, mask, lpips),
                f"mae_{unit}": mae(temperature, frame.thermal, mask=mask),
            }
            if renders is not None:
                _draw_thermal(renders / key, frame.name, temperature, np.where(mask, frame.thermal, np.nan), model, unit)
        if renders is not None:
            for when, sfm_per_metre in (("before", 1.0), ("after", thermal_model.sfm_per_metre)):
                pose = scene.thermal_from_world(frame.name, sfm_per_metre)
                gray = rgb_model.render(scene.rig.thermal, pose) @ np.array(GRAY_WEIGHTS, np.float32)
                overlay = edge_overlay(gray, thermal_model.range.normalise(frame.thermal), mask)
                save_png(renders / "overlay" / f"{frame.name}.{when}.png", overlay)
        if progress is not None:
            progress(done + 1, len(frames), frame.name)
    result: dict[str, Any] = {}
    for key, per_frame in scores.items():
        if per_frame:
            names = next(iter(per_frame.values()))
            result[key] = {m: float(np.mean([s[m] for s in per_frame.values()])) for m in names}
        else:
            result[key] = {}
        result[key]["per_frame"] = per_frame
    span = thermal_model.range
    result["temperature_range_c" if unit == "c" else "count_range"] = [span.lo, span.hi]
    return result


def _likeness(view: np.ndarray, reference: np.ndarray, mask: np.ndarray, lpips: Lpips | None) -> dict[str, float]:
    found = {"psnr": psnr(view, reference, mask=mask), "ssim": ssim_index(view, reference, mask=mask)}
    if lpips is not None and min(mask.shape) >= SMALLEST_PX:
        found["lpips"] = lpips(view, reference, mask=mask)
    return found


def _draw_thermal(
    folder: Path, name: str, temperature: np.ndarray, reference: np.ndarray, model: ThermalModel, unit: str
) -> None:
    label = "°C" if unit == "c" else "counts"
    lo, hi = model.range.lo, model.range.hi
    limit = THERMAL_ERROR_SHARE * (hi - lo)
    save_png(folder / f"{name}.reference.png", palette(reference, lo, hi))
    save_png(folder / f"{name}.render.png", palette(temperature, lo, hi))
    save_png(folder / f"{name}.error.png", error_map(temperature, reference, limit, label))
