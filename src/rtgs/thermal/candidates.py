"""Models that are fitted without the validation frames, so that they can be compared on them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from rtgs.config import DriftKind
from rtgs.thermal.fit import Fitted
from rtgs.thermal.least_squares import solve
from rtgs.thermal.robust import RobustSolution, solve_robustly
from rtgs.thermal.validation import EarlyStopping, Validation


@dataclass(frozen=True, eq=False)
class FirstSolve:
    """Models without validation frames, by plain least squares. Drift and pattern are chosen by comparing them.

    Attributes:
        offsets: each frame has an offset, and all frames have a quadratic surface in common, which stands in for vignetting.
        no_surface: with offsets, without the surface.
        no_offsets: with the surface, without offsets.
    """

    offsets: Fitted
    no_surface: Fitted
    no_offsets: Fitted

    def under(self, kind: DriftKind) -> Fitted:
        """The model to start from when this kind of drift is chosen."""
        return self.no_offsets if kind == "off" else self.offsets


def first_solve(validation: Validation) -> FirstSolve:
    """One multi-right-hand-side solve with three columns. Without validation frames there is nothing to compare, and one column."""
    fit, start, factor = validation.fit, validation.fit.coverage.prior[:, None], validation.fit.settings.default_factor
    if not validation.frames:
        problem = fit.problem((factor,), validation.others)
        solution = solve(problem, start, iterations=fit.settings.unvalidated_iterations, each=fit.each)
        return FirstSolve(*Fitted.of(fit, solution.x) * 3)
    offsets, surfaces = torch.tensor([1.0, 1.0, 0.0]), torch.tensor([1.0, 0.0, 1.0])
    problem = fit.problem((factor,) * 3, validation.others, offsets=offsets, surface=validation.surface, surfaces=surfaces)
    stopping = EarlyStopping(validation, ["offset", "offset", "off"], fit.settings.stop_share_first)
    solution = solve(problem, start.expand(-1, 3), iterations=fit.settings.iterations, settled=stopping, each=fit.each)
    return FirstSolve(*Fitted.of(fit, solution.x))


@dataclass(frozen=True, eq=False)
class Candidates:
    """Solutions without the validation frames, one for each ridge factor."""

    validation: Validation
    solution: RobustSolution

    @property
    def iterations(self) -> int:
        """How many were made."""
        return self.solution.iterations

    def fitted(self, column: int) -> Fitted:
        """One of them, with its images. Those of the others take no memory."""
        fit, x = self.validation.fit, self.solution.x
        fitted_frames = set(self.validation.others)
        images = []
        for f in range(len(fit.data)):
            shown = self.solution.shown(f) if f in fitted_frames else fit.design.image(f, x)
            images.append(shown[..., column].clone())
        return Fitted(x[:, column : column + 1].clone(), images)


def solve_candidates(
    validation: Validation,
    factors: Sequence[float],
    kind: DriftKind,
    start: Fitted,
    iterations: int,
    settled: Callable[[Tensor], bool] = lambda x: False,
) -> Candidates:
    """Huber's loss on all but the validation frames, one column for each ridge factor; gains as they suit the images of `start`."""
    fit, others = validation.fit, validation.others
    problem = fit.problem(factors, others, drift=fit.gauged(kind, start.images))
    shown = [start.images[f][..., None] for f in others]
    solution = solve_robustly(
        problem, start.x, huber=fit.settings.huber, iterations=iterations, shown=shown, settled=settled, each=fit.each
    )
    return Candidates(validation, solution)


def few_iterations(validation: Validation, kind: DriftKind, start: Fitted) -> Fitted:
    """A model after a few more iterations with the default ridge, so that two kinds of drift can be compared from the same start."""
    settings = validation.fit.settings
    return solve_candidates(validation, (settings.default_factor,), kind, start, settings.gain_iterations).fitted(0)
