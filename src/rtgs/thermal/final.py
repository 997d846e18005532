"""The last part of the fit: Huber's loss on all training frames, validation frames included."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from rtgs.config import DriftKind
from rtgs.thermal.drift import Drift, in_gauge
from rtgs.thermal.fit import Fit, Fitted
from rtgs.thermal.passes import Passes
from rtgs.thermal.robust import solve_robustly


@dataclass(frozen=True, eq=False)
class FinalFit:
    """The solution, the frames' drift before the gauge is fixed, and the history ("step", "loss")."""

    fitted: Fitted
    drift: Drift
    history: dict[str, list[float]]


def fit_all_frames(fit: Fit, factor: float, kind: DriftKind, start: Fitted, passes: Passes) -> FinalFit:
    """A few more iterations from `start`, on all frames, with the gains that suit the images of `start`.

    Iterations are few on purpose: what conjugate gradients find late is what fits the noise.

    Args:
        fit: with the sensor's pattern removed.
        factor: of the ridge.
    """
    frames, iterations = range(len(fit.data)), fit.settings.last_iterations
    history: dict[str, list[float]] = {"step": [], "loss": []}

    def note(step: int, drift: Drift, found: Fitted) -> None:
        rms = _rms(fit.residuals(drift, found.images), fit.data.valid)
        history["step"].append(step)
        history["loss"].append(rms)
        passes.text = f"residual {rms:.4f}"

    drift = fit.drift(kind, start.images)
    note(0, drift, start)
    problem = fit.problem((factor,), frames, drift=(kind, in_gauge(drift)[0]))
    shown = [i[..., None] for i in start.images]
    solution = solve_robustly(problem, start.x, huber=fit.settings.huber, iterations=iterations, shown=shown, each=passes)
    found = Fitted(solution.x, [solution.shown(f)[..., 0] for f in frames])
    drift = fit.drift(kind, found.images, [solution.weights(f)[..., 0] for f in frames])
    note(iterations, drift, found)
    return FinalFit(found, drift, history)


def _rms(left: Sequence[Tensor], valid: Tensor) -> float:
    """Root mean square of residuals `[h, w]` over valid pixels."""
    return math.sqrt(sum(float((valid * r**2).sum()) for r in left) / (len(left) * float(valid.sum())))
