"""How far the edges miss each other in ways that the scale cannot mend: what turning the thermal camera would still gain."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rtgs.models import RgbModel
from rtgs.records.scene import Scene
from rtgs.scale.curves import LocalCurves
from rtgs.scale.progress import RenderProgress
from rtgs.scale.rig_loss import RigLoss
from rtgs.scale.rig_motion import motions


class Misfit(NamedTuple):
    """By how many pixels the picture would move where the edges meet best if the camera may turn. renders: pictures rendered."""

    px: float
    renders: int


NO_MISFIT = Misfit(0.0, 0)
"""Nothing has been measured: the calibration is refined with the scale, or the answer is in doubt already."""


def misfit(scene: Scene, model: RgbModel, curves: LocalCurves, theta: float, progress: RenderProgress) -> Misfit:
    """The turn of the thermal camera about its three axes by which the mean loss would fall, as motion of the picture.

    A wrong rotation, an RGB model with its edges in the wrong places, and thermal images of something else all leave such a turn. What
    they do to the scale itself cannot be seen, since the answer is where the loss is lowest. It is of the same size in pixels.

    It is at most the picture's width, which also stands for curves that are not curved upwards.

    The step is Newton's, −H⁻¹g. H is the Gauss–Newton matrix, divided by how much that matrix overstates the curvature along the scale,
    where the curves show the true one.

    Args:
        curves: around the answer. theta: the answer, within them.
    """
    loss = RigLoss(scene, motions(scene.rig, ("rotation",)), progress)
    progress.plan(len(curves.frames))
    here = loss.evaluate(curves.objective, curves.frames, np.array([theta, *np.zeros(len(loss.motions))]))
    curvature = curves.curvature(theta)
    widest = float(scene.rig.thermal.width)
    if not curvature > 0.0:
        return Misfit(widest, len(curves.frames))
    overstated = here.gauss_newton[0, 0] / curvature
    turn, *_ = np.linalg.lstsq(here.gauss_newton[1:, 1:], here.gradient[1:])
    px = overstated * np.linalg.norm(turn * loss.pixels(here.x, model.gaussians)[1:])
    return Misfit(min(float(px), widest), len(curves.frames))
