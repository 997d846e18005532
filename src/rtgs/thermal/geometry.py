"""Whether the geometry follows the thermal images: finer Gaussians are fitted, and validation frames decide."""

from __future__ import annotations

from dataclasses import replace

import torch

from rtgs.config import DriftKind
from rtgs.maths import sh
from rtgs.records.decision import Decision
from rtgs.records.gaussians import Gaussians
from rtgs.thermal.candidates import solve_candidates
from rtgs.thermal.choices import measured, too_few
from rtgs.thermal.coverage import measure_coverage
from rtgs.thermal.fit import Fit, Fitted
from rtgs.thermal.follow import Finer, finer_gaussians
from rtgs.thermal.refine import Geometry, refined
from rtgs.thermal.surface import Surface
from rtgs.thermal.validation import EarlyStopping, Validation


def choose_geometry(
    validation: Validation, kind: DriftKind, factor: float, found: Fitted, geometry: Geometry
) -> tuple[Gaussians, Fit, Fitted, Decision]:
    """Split Gaussians where the residuals of the photographs ask for it, moved or not, and keep them if validation frames agree.

    Args:
        validation: with the sensor's pattern removed.
        kind, factor, found: drift, ridge and the model so far.

    Returns:
        The Gaussians that are kept, their fit (with the same photographs), their model without validation frames, and the decision.
    """
    fit, before = validation.fit, geometry.gaussians
    if not validation.frames:
        return before, fit, found, Decision("geometry", "frozen", too_few(validation, 1))
    moved, coarse, shown = before, fit, found
    if geometry.moves:
        moved, x = refined(fit, geometry, found.x, fit.drift(kind, found.images), validation.others)
        fit.design.release()
        coarse = replace(fit, design=geometry.design(moved))
        (shown,) = Fitted.of(coarse, x)
    rows, numbers = geometry.camera.rows(geometry.every), fit.settings.follow
    surface = Surface.of(moved, rows, fit.data.poses, fit.data.valid, geometry.settings, numbers)
    residuals = fit.residuals(fit.drift(kind, shown.images), shown.images)
    finer = finer_gaussians(coarse.design, moved, fit.data, geometry.camera, surface, residuals, numbers, fit.each)
    if len(finer.gaussians) == len(before):
        return before, fit, found, Decision("geometry", "frozen", "No Gaussian is larger than a pixel of the photographs.")

    coarse.design.release()
    x = torch.cat([coarse.design.harmonics(shown.x)[finer.parents].flatten(0, 1), shown.x[-1:]])
    design = geometry.design(finer.gaussians)
    unseen = torch.cat([sh.C0 * design.harmonics(x)[:, 0, 0], x[-1]])

    def fitted_on(frames: range | list[int]) -> Fit:
        return replace(fit, design=design, coverage=measure_coverage(design, fit.data, fit.settings, fit.each, frames, unseen))

    on_others = Validation(fitted_on(validation.others), validation.frames)
    stopping = EarlyStopping(on_others, [kind], fit.settings.stop_share_ridge)
    (start,) = Fitted.of(on_others.fit, x)
    after = solve_candidates(on_others, (factor,), kind, start, fit.settings.iterations, stopping).fitted(0)
    compared = [(validation, found.images), (on_others, after.images)]
    errors = [model.errors(kind, images) for model, images in compared]
    missed, still = (float(model.errors(kind, images, finer.missing).sum()) for model, images in compared)
    change = float(errors[1].sum()) / max(float(errors[0].sum()), 1e-30) - 1.0
    reason = _reason(before, finer, still / max(missed, 1e-30) - 1.0, change)
    if still >= missed or change > numbers.most_harm:
        design.release()
        if geometry.moves:  # halves of Gaussians where they were may be better
            return choose_geometry(validation, kind, factor, found, replace(geometry, moves=False))
        return before, fit, found, measured("geometry", "frozen", f"Tried and not kept: {reason}", validation, errors, None)
    return (
        finer.gaussians,
        fitted_on(range(len(fit.data))),
        after,
        measured("geometry", "follows", reason, validation, errors, None),
    )


def _reason(before: Gaussians, finer: Finer, there: float, everywhere: float) -> str:
    """How many Gaussians there are, where they went, and by which shares the errors on validation frames change."""
    count = int((torch.bincount(finer.parents, minlength=len(before)) > 1).sum())
    return (
        f"{count:,} of {len(before):,} Gaussians were split, which makes {len(finer.gaussians):,}. {100 * finer.agreed:.0f} % of their "
        "parts lie where several photographs agree that something is missing. On validation frames the error changes by "
        f"{100 * there:+.1f} % there and by {100 * everywhere:+.1f} % everywhere."
    )
