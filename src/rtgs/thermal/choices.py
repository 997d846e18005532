"""What the fit decides by itself: rows, drift, the sensor's pattern, gains and the ridge. Each choice comes with a `Decision`.

Errors in decisions are mean absolute errors of a pixel on validation frames, after the drift that suits each frame best.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from torch import Tensor

from rtgs.records.decision import Decision
from rtgs.thermal.candidates import FirstSolve, few_iterations, solve_candidates
from rtgs.thermal.drift import DriftKind
from rtgs.thermal.fit import Fitted
from rtgs.thermal.frames import ThermalFrames
from rtgs.thermal.settings import LinearSettings
from rtgs.thermal.validation import EarlyStopping, Validation, is_clearly_less

Asked = Literal["auto"] | DriftKind
GAINS: DriftKind = "gain-offset"


def choose_rows(data: ThermalFrames, settings: LinearSettings) -> tuple[int, Decision]:
    """How many rows of the photographs one is used of, so that about `settings.pixels` are fitted."""
    pixels = len(data) * data.valid.numel()
    every = min(max(round(pixels / settings.pixels), 1), settings.most_rows)
    if not bool(data.valid[every // 2 :: every].any()):
        return 1, Decision("rows", "all", f"No row of every {every}th has a valid pixel.")
    millions = f"The photographs have {pixels / 1e6:.1f} million pixels; about {settings.pixels / 1e6:.1f} million are enough."
    return every, Decision("rows", "all" if every == 1 else f"1 in {every}", millions)


def looks_drifting(validation: Validation, first: FirstSolve) -> bool:
    """Whether gains and offsets of the validation frames' own would explain enough of their error to consider drift at all."""
    if not validation.is_enough:
        return False
    return validation.own_drift_share("off", first.no_offsets.images) >= validation.fit.settings.offset_share


def choose_drift(validation: Validation, first: FirstSolve, asked: Asked) -> tuple[DriftKind, Decision]:
    """Whether each frame has an offset. Gains are chosen later, when the pattern is known."""
    settings, before, after = validation.fit.settings, first.no_offsets.images, first.offsets.images
    errors = [validation.errors("offset", i) for i in (before, after)] if validation.frames else None

    def decided(choice: str, reason: str) -> Decision:
        return _decision("drift", choice, reason, validation, errors, settings.drift_gain)

    if asked != "auto":
        return asked, decided("off" if asked == "off" else "offset", f"The setting drift = {asked} asks for it.")
    if errors is None or not validation.is_enough:
        return "off", decided("off", _too_few(validation))
    if not looks_drifting(validation, first):
        share = validation.own_drift_share("off", before)
        return "off", decided(
            "off",
            f"Offsets and gains would explain {_percent(share)} of the error on validation frames; "
            f"drift is considered from {_percent(settings.offset_share)} on.",
        )
    if not is_clearly_less(errors[1], errors[0], settings.drift_gain):
        return "off", decided("off", _criterion("Offsets do not clearly lower", settings.drift_gain))
    level = validation.level_error("offset", after) / float(validation.errors("off", before).sum())
    if level > settings.level_loss:
        return "off", decided(
            "off",
            _levels("offsets", level, settings),
        )
    return "offset", decided("offset", _criterion("Offsets lower", settings.drift_gain))


def choose_pattern(validation: Validation, first: FirstSolve) -> tuple[bool, Decision]:
    """Whether the sensor adds a pattern to every photograph.

    The pattern is taken from the residuals of the fitted frames, and must lower the error on validation frames. The rival is a model
    without the common surface, which may explain the pattern by the scene: a wall that stays at the top of all photographs is no
    vignetting.
    """
    fit, settings = validation.fit, validation.fit.settings
    if not validation.is_enough:
        return False, Decision("pattern", "none", _too_few(validation))
    pattern = fit.pattern("offset", first.offsets.images, validation.others)
    before = validation.without_surface().errors("gain-offset", first.no_surface.images)
    after = Validation(fit.without(pattern), validation.frames).errors("gain-offset", first.offsets.images)
    found = is_clearly_less(after, before, settings.pattern_gain)
    reason = _criterion("It lowers" if found else "It does not clearly lower", settings.pattern_gain)
    return found, _decision("pattern", "removed" if found else "none", reason, validation, [before, after], settings.pattern_gain)


def choose_gains(
    validation: Validation, kind: DriftKind, start: Fitted, asked: Asked, is_drifting: bool
) -> tuple[DriftKind, Fitted, Decision]:
    """Whether each frame has a gain besides its offset.

    Args:
        validation: with the sensor's pattern removed, because vignetting looks like gains.
        kind, start: drift as chosen so far, and its model.
        is_drifting: whether drift is considered at all (`looks_drifting`).

    Returns:
        The kind of drift, its model after a few more iterations if gains are fitted, and the decision.
    """
    settings, gains = validation.fit.settings, GAINS

    def no(reason: str, errors: Sequence[Tensor] | None = None) -> tuple[DriftKind, Fitted, Decision]:
        return kind, start, _decision("gains", "off", reason, validation, errors, settings.drift_gain)

    if asked == "gain-offset":
        reason = f"The setting drift = {asked} asks for it."
        return gains, few_iterations(validation, gains, start), Decision("gains", "on", reason)
    if asked != "auto":
        return no(f"The setting drift = {asked} excludes gains.")
    if not validation.is_enough:
        return no(_too_few(validation))
    if not is_drifting:
        return no("The photographs do not look as if they drifted (see drift).")
    share = validation.own_drift_share(kind, start.images)
    if share < settings.gain_share:
        return no(
            f"Gains would explain {_percent(share)} of the error that is left; "
            f"they are considered from {_percent(settings.gain_share)} on."
        )
    before, after = few_iterations(validation, kind, start), few_iterations(validation, gains, start)
    errors = [validation.errors(gains, i.images) for i in (before, after)]
    if not is_clearly_less(errors[1], errors[0], settings.drift_gain):
        return no(_criterion("Gains do not clearly lower", settings.drift_gain), errors)
    level = validation.level_error(gains, after.images) / validation.level_error(kind, before.images)
    if level > settings.level_loss:
        return no(
            _levels("gains", level, settings),
            errors,
        )
    reason = _criterion("Gains lower", settings.drift_gain)
    decision = _decision("gains", "on", reason, validation, errors, settings.drift_gain)
    return gains, few_iterations(validation, gains, after), decision


def choose_ridge(validation: Validation, kind: DriftKind, start: Fitted) -> tuple[float, Fitted, Decision]:
    """The ridge's factor with the smallest error on validation frames under Huber's loss, and its solution.

    Huber's loss comes first here because squares would ask for a stronger ridge, to hold down the few pixels with large errors.

    Args:
        validation: with the sensor's pattern removed.
    """
    settings = validation.fit.settings
    if not validation.frames:
        return settings.default_factor, start, Decision("ridge", f"{settings.default_factor:g}", _too_few(validation, 1))
    factors = settings.ridge_factors
    stopping = EarlyStopping(validation, [kind] * len(factors), settings.stop_share_ridge)
    fitted, iterations = solve_candidates(validation, factors, kind, start, settings.iterations, stopping)
    best = int(stopping.errors.argmin())
    listed = ", ".join(f"{f:g}" for f in factors)
    reason = f"Of the factors {listed}, this one has the smallest error on validation frames, after {iterations} iterations."
    usual = factors.index(settings.default_factor) if settings.default_factor in factors else best
    errors = [stopping.errors[usual], stopping.errors[best]]
    return factors[best], fitted[best].copied(), _decision("ridge", f"{factors[best]:g}", reason, validation, errors, None)


def _decision(
    name: str, choice: str, reason: str, validation: Validation, errors: Sequence[Tensor] | None, threshold: float | None
) -> Decision:
    """A `Decision` with errors before and after, each Σ over validation frames, in °C or counts."""
    if errors is None:
        return Decision(name, choice, reason)
    data = validation.fit.data
    before, after = (data.unit_size * validation.mean(e) for e in errors)
    return Decision(name, choice, reason, before, after, data.unit, threshold)


def _percent(share: float) -> str:
    return f"{100 * max(share, 0.0):.2g} %"


def _criterion(what_happens: str, share: float) -> str:
    required = f"required: by {_percent(share)}, by more than a standard error, and in most frames"
    return f"{what_happens} the error within validation frames ({required})."


def _levels(which: str, ratio: float, settings: LinearSettings) -> str:
    allowed = f"{settings.level_loss:g} times is allowed"
    return f"With {which}, the error of levels is {ratio:.2f} times the error without; {allowed}."


def _too_few(validation: Validation, needed: int | None = None) -> str:
    needed = needed or validation.fit.settings.fewest_frames
    return f"There are too few validation frames to decide: {len(validation.frames)} of {needed} that are needed."
