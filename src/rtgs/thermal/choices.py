"""What the fit decides by itself: rows, drift, the sensor's pattern, gains and the ridge. Each choice comes with a `Decision`.

Errors in decisions are mean absolute errors of a pixel on validation frames, after the drift that suits each frame best.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from torch import Tensor

from rtgs.config import DriftKind, DriftSetting
from rtgs.records.decision import Decision
from rtgs.thermal.candidates import FirstSolve, few_iterations, solve_candidates
from rtgs.thermal.fit import Fitted
from rtgs.thermal.frames import ThermalFrames
from rtgs.thermal.settings import LinearSettings
from rtgs.thermal.validation import EarlyStopping, Validation, is_clearly_less

GAINS: DriftKind = "gain-offset"


def choose_rows(data: ThermalFrames, settings: LinearSettings) -> tuple[int, Decision]:
    """How many rows of the photographs one is used of, so that about `settings.pixels` are fitted, and no more than fit into memory."""
    pixels = len(data) * data.valid.numel()
    enough = min(max(round(pixels / settings.pixels), 1), settings.most_rows)
    fitting = math.ceil(settings.bytes_per_pixel * pixels / (settings.images_share * settings.memory_bytes))
    every = min(max(enough, fitting), len(data.valid))
    if not bool(data.valid[every // 2 :: every].any()):
        return 1, Decision("rows", "all", f"No row of every {every}th has a valid pixel.")
    reason = f"The photographs have {pixels:,} pixels in all; about {settings.pixels:,} are enough."
    if fitting > enough:
        reason = f"The photographs have {pixels:,} pixels in all; more than one row in {every} would take more memory than the run has."
    return every, Decision("rows", "all" if every == 1 else f"1 in {every}", reason)


def choose_drift(validation: Validation, first: FirstSolve, asked: DriftSetting) -> tuple[DriftKind, Decision]:
    """Whether each frame has an offset. Gains are chosen later, when the pattern is known."""
    settings, errors, share = validation.fit.settings, None, 0.0
    if validation.frames:
        errors = [validation.errors("offset", model.images) for model in (first.no_offsets, first.offsets)]
        share = validation.own_drift_share("off", first.no_offsets.images)
    kind: DriftKind = "offset"
    if asked != "auto":
        kind, reason = asked, f"The setting drift = {asked} asks for it."
    elif errors is None or not validation.is_enough:
        kind, reason = "off", too_few(validation)
    elif share < settings.drift_share:
        kind, reason = "off", _explains_little(share, settings)
    elif is_clearly_less(errors[1], errors[0], settings.drift_gain):
        reason = _clearly("Offsets lower", settings.drift_gain)
    else:
        kind, reason = "off", _clearly("Offsets do not clearly lower", settings.drift_gain)
    return kind, measured("drift", "off" if kind == "off" else "offset", reason, validation, errors, settings.drift_gain)


def choose_pattern(validation: Validation, first: FirstSolve) -> tuple[bool, Decision]:
    """Whether the sensor adds a pattern to every photograph.

    The pattern is taken from the residuals of the fitted frames, and must lower the error on validation frames. The rival is a model
    without the common surface, which may explain the pattern by the scene: a wall that stays at the top of all photographs is no
    vignetting.
    """
    fit = validation.fit
    if not validation.is_enough:
        return False, Decision("pattern", "none", too_few(validation))
    pattern = fit.pattern("offset", first.offsets.images, validation.others)
    before = validation.without_surface().errors("gain-offset", first.no_surface.images)
    after = Validation(fit.without(pattern), validation.frames).errors("gain-offset", first.offsets.images)
    share = fit.settings.pattern_gain
    found = is_clearly_less(after, before, share)
    reason = _clearly("It lowers" if found else "It does not clearly lower", share)
    return found, measured("pattern", "removed" if found else "none", reason, validation, [before, after], share)


def choose_gains(
    validation: Validation, kind: DriftKind, start: Fitted, asked: DriftSetting
) -> tuple[DriftKind, Fitted, Decision]:
    """Whether each frame has a gain besides its offset.

    Args:
        validation: with the sensor's pattern removed, because vignetting looks like gains.
        kind, start: drift as chosen so far, and its model.

    Returns:
        The kind of drift, its model after a few more iterations if gains are fitted, and the decision.
    """
    settings = validation.fit.settings
    if asked == "gain-offset":
        reason = f"The setting drift = {asked} asks for it."
        return GAINS, few_iterations(validation, GAINS, start), Decision("gains", "on", reason)
    if asked != "auto":
        return kind, start, Decision("gains", "off", f"The setting drift = {asked} excludes gains.")
    if not validation.is_enough:
        return kind, start, Decision("gains", "off", too_few(validation))
    share = validation.own_drift_share(kind, start.images)
    if share < settings.drift_share:
        return kind, start, Decision("gains", "off", _explains_little(share, settings))
    before, after = few_iterations(validation, kind, start), few_iterations(validation, GAINS, start)
    errors = [validation.errors(GAINS, model.images) for model in (before, after)]
    if not is_clearly_less(errors[1], errors[0], settings.drift_gain):
        reason = _clearly("Gains do not clearly lower", settings.drift_gain)
        return kind, start, measured("gains", "off", reason, validation, errors, settings.drift_gain)
    reason = _clearly("Gains lower", settings.drift_gain)
    made = measured("gains", "on", reason, validation, errors, settings.drift_gain)
    return GAINS, few_iterations(validation, GAINS, after), made


def choose_ridge(validation: Validation, kind: DriftKind, start: Fitted) -> tuple[float, Fitted, Decision]:
    """The ridge's factor with the smallest error on validation frames under Huber's loss, and its solution.

    Huber's loss comes first here because squares would ask for a stronger ridge, to hold down the few pixels with large errors.

    Args:
        validation: with the sensor's pattern removed.
    """
    settings = validation.fit.settings
    if not validation.frames:
        return settings.default_factor, start, Decision("ridge", f"{settings.default_factor:g}", too_few(validation, 1))
    factors = settings.ridge_factors
    stopping = EarlyStopping(validation, [kind] * len(factors), settings.stop_share_ridge)
    candidates = solve_candidates(validation, factors, kind, start, settings.iterations, stopping)
    best = int(stopping.errors.argmin())
    listed = ", ".join(f"{f:g}" for f in factors)
    reason = f"Of the factors {listed}, this one has the smallest error on validation frames, after {candidates.iterations} iterations."
    usual = factors.index(settings.default_factor) if settings.default_factor in factors else best
    errors = [stopping.errors[usual], stopping.errors[best]]
    return factors[best], candidates.fitted(best), measured("ridge", f"{factors[best]:g}", reason, validation, errors, None)


def measured(
    name: str, choice: str, reason: str, validation: Validation, errors: Sequence[Tensor] | None, threshold: float | None
) -> Decision:
    """A `Decision` with errors before and after, each Σ over validation frames, in °C or counts."""
    if errors is None:
        return Decision(name, choice, reason)
    data = validation.fit.data
    before, after = (data.unit_size * validation.mean(e) for e in errors)
    return Decision(name, choice, reason, before, after, data.unit, threshold)


def _explains_little(share: float, settings: LinearSettings) -> str:
    needed = f"{100 * settings.drift_share:g} % are required"
    return (
        f"The frames' own offsets and gains would explain only {100 * share:.2g} % of the error on validation frames; {needed}."
    )


def _clearly(what_happens: str, share: float) -> str:
    required = f"required: by {100 * share:g} %, by more than a standard error, and in most frames"
    return f"{what_happens} the error within validation frames ({required})."


def too_few(validation: Validation, needed: int | None = None) -> str:
    needed = needed or validation.fit.settings.fewest_frames
    return f"There are too few validation frames to decide: {len(validation.frames)} of {needed} that are needed."
