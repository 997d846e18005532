"""Gauss–Newton with a line search, for one unknown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rtgs.scale.objective import Evaluation, Objective
from rtgs.scale.records import Counter, History

_MOST_STEPS = 12


def descend(
    objective: Objective,
    indices: Sequence[int],
    theta: float,
    *,
    longest: float,
    tolerance: float,
    counter: Counter,
    history: History,
) -> tuple[float, float]:
    """Go down the mean loss of some frames from θ.

    The first step is Gauss–Newton's. Its curvature is that of the residuals alone, too large wherever the two modalities disagree, so
    from the second step on the slopes' own change takes its place. A step is taken only where it lowers the loss (Eq. 7 of the
    pictures compared); else it is cut to where the two slopes, or half the way, put the minimum.

    Args:
        longest: of a step in θ. tolerance: a step shorter than this is the last.

    Returns:
        θ, and the curvature d²L/dθ² as the last two points show it.
    """

    def evaluate(at: float) -> Evaluation:
        found = []
        for i in indices:
            found.append(objective.evaluate(i, at))
            counter(f"s = {np.exp(at):.5g}")
        mean = Evaluation(*(float(np.mean([getattr(e, k) for e in found])) for k in ("loss", "slope", "curvature")))
        history.add(at, mean.loss, mean.slope)
        return mean

    here = evaluate(theta)
    curvature = here.curvature
    for _ in range(_MOST_STEPS):
        if here.slope == 0.0 or not curvature > 0.0:
            break
        step = float(np.clip(-here.slope / curvature, -longest, longest))
        there = evaluate(theta + step)
        while there.loss >= here.loss and abs(step) > tolerance:
            crossing = step * here.slope / (here.slope - there.slope) if there.slope * here.slope < 0 else 0.5 * step
            step = float(np.clip(crossing / step, 0.1, 0.7)) * step
            there = evaluate(theta + step)
        change = (there.slope - here.slope) / step
        if there.loss >= here.loss:
            break
        theta, here = theta + step, there
        # Concave ground has its minimum further on: go as far as allowed.
        curvature = change if change > 0 else abs(here.slope) / longest
        if abs(step) <= tolerance:
            break
    return theta, curvature
