"""What an error of the calibration does to the scale."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rtgs.scale.objective import Objective
from rtgs.scale.progress import RenderProgress
from rtgs.scale.rig_loss import RigLoss
from rtgs.scale.rig_motion import stated_motions


def calibration_std_log(objective: Objective, theta: float, indices: Sequence[int]) -> float | None:
    """Standard deviation of ln s that the calibration's errors bring, to first order; None where the rig states none.

    At the minimum the loss has no slope. Where a calibration error p gives it one, the minimum moves by dθ/dp = −L_θp / L_θθ, both from
    the Gauss–Newton matrix. The baseline's length is not seen at all: s·|t| is what the images know, so its error is the scale's.

    Args:
        theta: the answer. indices: the objective's frames that it is taken from.
    """
    rig = objective.scene.rig
    if rig.calibration_std is None:
        return None
    variance = rig.calibration_std.baseline_length**2
    uncertain = stated_motions(rig)
    if uncertain:
        loss = RigLoss(objective.scene, uncertain, RenderProgress(None))
        matrix = loss.evaluate(objective, indices, np.array([theta, *np.zeros(len(uncertain))])).gauss_newton
        shifts = -matrix[0, 1:] / matrix[0, 0]  # of θ, by one standard deviation of each
        variance += float(shifts @ shifts)
    return math.sqrt(variance)
