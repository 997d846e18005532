"""The plan of the linear thermal fit (`ThermalConfig.solver = "linear"`).

Geometry, opacity and poses are frozen while colours are fitted, so a thermal image is affine in the harmonics and the background: fitting
them is linear least squares. Nothing is added to the colours and nothing is clamped. docs/how-it-works/temperatures.md has the equations.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from rtgs.base.progress import Progress
from rtgs.base.threads import threads_at_most
from rtgs.config import ThermalConfig
from rtgs.images.patterns import FEWEST_FRAMES
from rtgs.models import RgbModel, ThermalModel
from rtgs.models.sensor import SensorModel
from rtgs.records.scene import Scene
from rtgs.thermal import choices
from rtgs.thermal.candidates import first_solve
from rtgs.thermal.colors import affine, as_model
from rtgs.thermal.design import Design
from rtgs.thermal.drift import in_gauge
from rtgs.thermal.final import fit_all_frames
from rtgs.thermal.fit import Fit
from rtgs.thermal.frames import ThermalFrames, color_range, training_range
from rtgs.thermal.geometry import choose_geometry
from rtgs.thermal.passes import Passes
from rtgs.thermal.refine import Geometry
from rtgs.thermal.settings import LinearSettings
from rtgs.thermal.validation import Validation


def fit_linear(
    scene: Scene,
    rgb_model: RgbModel,
    sfm_per_metre: float,
    config: ThermalConfig,
    progress: Progress | None = None,
    settings: LinearSettings | None = None,
) -> ThermalModel:
    """As `fit_thermal`, by linear least squares.

    Args:
        settings: the numbers of the method; None: the defaults.
    """
    settings, span = settings or LinearSettings(), color_range(scene)
    photographs = ThermalFrames.of(scene, scene.train_frames, sfm_per_metre, span)
    every, rows = choices.choose_rows(photographs, settings)
    threads = settings.threads_for(photographs.valid.numel() // every)
    with threads_at_most(threads):
        data = photographs.rows(every)
        passes = Passes(len(data) * settings.usual_passes, progress)
        gaussians, camera, degree = rgb_model.gaussians.detach(), scene.rig.thermal, config.sh_degree
        design = partial(Design, camera=camera, poses=data.poses, degree=degree, settings=rgb_model.settings, threads=threads)
        kept = partial(design, every=every, kept_bytes=settings.weights_bytes(len(data) * data.valid.numel()))

        # What the Gaussians cover.
        fit = Fit.of(kept(gaussians), data, settings, passes)

        # Drift, pattern, gains and ridge, each decided on validation frames.
        validation = Validation.of(fit, scene.split)
        first = first_solve(validation)
        kind, drift = choices.choose_drift(validation, first, config.drift)
        found = first.under(kind)
        has_pattern, pattern = choices.choose_pattern(validation, first)
        del first  # its images take memory
        clean = fit.without(fit.pattern(kind, found.images, validation.others)) if has_pattern else fit
        validation = Validation(clean, validation.frames)
        kind, found, gains = choices.choose_gains(validation, kind, found, config.drift)
        factor, found, ridge = choices.choose_ridge(validation, kind, found)
        decisions = [rows, drift, pattern, gains, ridge]

        # Finer Gaussians.
        if config.geometry != "frozen":
            geometry = Geometry(gaussians, camera, every, scene.extent, config.geometry == "refine", rgb_model.settings, kept)
            gaussians, followed, found, decision = choose_geometry(validation, kind, factor, found, geometry)
            fit, clean, decisions = fit.on(followed), clean.on(followed), [*decisions, decision]

        # The fit on all frames. The pattern is taken anew, from images that have no part in it any more.
        if has_pattern:
            clean = fit.without(fit.pattern(kind, found.images, range(len(data))))
        final = fit_all_frames(clean, factor, kind, found, passes)
        sensor = SensorModel()
        if has_pattern:
            images = final.fitted.images
            if every > 1:  # a pattern belongs to single pixels: once more, on whole photographs, as many as fit into memory
                pixels = photographs.valid.numel()
                most = max(settings.memory_bytes // (settings.bytes_per_pixel * pixels), FEWEST_FRAMES)
                whole = photographs.some(most)
                fit = replace(fit, design=design(gaussians, poses=whole.poses, kept_bytes=0), data=whole)
                images = [i[..., 0] for i in fit.images(final.fitted.x)]
            drawn = fit.pattern(kind, images, range(len(fit.data)))
            sensor = SensorModel(pattern=drawn.numpy() * np.float32(span.linear.width))

        # The gauge, and the model.
        gauged, gain, offset = in_gauge(final.drift)
        if kind != "off":
            sensor = replace(sensor, drift=gauged.by_frame(data.names, span))
        x = affine(fit.design, final.fitted.x, gain, fit.median * (1.0 - gain) + offset)
        passes.finish()
        scores = training_range(scene)
        shown = replace(rgb_model, gaussians=gaussians)
        model = as_model(x, fit.design, shown, unit=data.unit, scores=scores, colors=span, sfm_per_metre=sfm_per_metre)
        return replace(model, history=final.history, sensor=sensor, decisions=tuple(decisions))
