"""What the calibration's errors do to the scale."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.scale_scenes import RIG, posts, with_rig

from rtgs.config import ScaleConfig
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.records.rig import CalibrationStd
from rtgs.scale import Objective, estimate_scale
from rtgs.scale.calibration import calibration_std_log
from rtgs.scale.progress import RenderProgress
from rtgs.scale.rig_loss import RigLoss
from rtgs.scale.rig_motion import stated_motions


@pytest.mark.thorough
@pytest.mark.parametrize("k", range(6))
def test_a_calibration_error_moves_the_scale_as_predicted(k: int) -> None:
    scene, model = posts()
    size = [0.004, 0.004, 0.004, 0.04, 0.04, 0.01][k]
    scene = with_rig(scene, replace(RIG, calibration_std=CalibrationStd(1.0, 1.0, 1.0, 1.0)))
    motion = stated_motions(scene.rig)[k]
    assert motion.std == 1.0  # so that amounts are in its own unit
    loss = Objective(scene, model, scene.train_frames, EdgeLoss(epsilon=0.05))
    frames = range(len(loss.frames))
    matrix = RigLoss(scene, (motion,), RenderProgress(None)).evaluate(loss, frames, np.zeros(2)).gauss_newton
    curvature = np.mean([loss.evaluate(i, 0.0).curvature for i in frames])
    assert matrix[0, 0] == pytest.approx(curvature, rel=1e-4)
    predicted = -matrix[0, 1] / matrix[0, 0] * size
    found = []
    for amount in (-size, size):
        off = replace(scene, capture=replace(scene.capture, rig=motion.apply(RIG, amount)))
        found.append(estimate_scale(off, model, ScaleConfig(solver="global", init=1.0, epsilon=0.05)).sfm_per_metre)
    moved = math.log(found[1] / found[0]) / 2
    # First order, of a loss that is far from quadratic: 40 %, and a tenth of a pixel where nothing moves.
    assert moved == pytest.approx(predicted, rel=0.4, abs=4e-3)


def test_calibration_errors_move_something() -> None:
    scene, model = posts()

    def std_log(std: CalibrationStd) -> float | None:
        stated = with_rig(scene, replace(RIG, calibration_std=std))
        loss = Objective(stated, model, scene.train_frames, EdgeLoss(epsilon=0.05))
        return calibration_std_log(loss, 0.0, range(len(loss.frames)))

    rotation = std_log(CalibrationStd(rotation_rad=0.004))
    assert rotation is not None and 0.01 < rotation < 0.2
    assert std_log(CalibrationStd(rotation_rad=0.008)) == pytest.approx(2 * rotation, rel=1e-6)
    assert std_log(CalibrationStd(baseline_length=0.02)) == 0.02
    both = std_log(CalibrationStd(baseline_length=0.02, rotation_rad=0.004))
    assert both == pytest.approx(math.hypot(0.02, rotation))


def test_the_interval_takes_the_calibration_in() -> None:
    scene, model = posts()
    stated = replace(
        scene, capture=replace(scene.capture, rig=replace(RIG, calibration_std=CalibrationStd(baseline_length=0.03)))
    )
    plain, wide = (estimate_scale(s, model, ScaleConfig(solver="global", init=1.0)) for s in (scene, stated))
    assert plain.calibration_std_log is None and wide.calibration_std_log == 0.03
    assert wide.sfm_per_metre == plain.sfm_per_metre
    assert plain.std_log is not None and wide.std_log == pytest.approx(math.hypot(plain.std_log, 0.03), rel=1e-6)
    assert wide.ci95 is not None and math.log(wide.ci95[1] / wide.ci95[0]) == pytest.approx(2 * 1.96 * 0.03, rel=0.1)
