"""Errors on validation frames, and early stopping."""

from __future__ import annotations

import pytest
import torch
from tests.helpers.thermal_scenes import fit_of, ring

from rtgs.config import DriftKind
from rtgs.records.capture import Split
from rtgs.thermal.validation import EarlyStopping, Validation, is_clearly_less


def test_what_a_surface_can_explain_is_no_error() -> None:
    """Whatever vignetting photographs have in common, the errors are the same with the surface; without it they are not."""
    scene, rgb, _ = ring()
    fit, frames = fit_of(scene, rgb), [1, 4, 7]
    surface, images = fit.surface(), {f: 0.9 * fit.data.images[f] for f in frames}
    vignetting = surface @ torch.tensor([0.1, -0.2, 0.3, 0.2, -0.1])
    plain, bent = Validation(fit, frames, surface), Validation(fit.without(-vignetting), frames, surface)
    kinds: tuple[DriftKind, ...] = ("off", "offset")
    for kind in kinds:
        torch.testing.assert_close(bent.errors(kind, images), plain.errors(kind, images), rtol=1e-3, atol=0)
        without = [v.without_surface().errors(kind, images) for v in (bent, plain)]
        assert (without[0] > 1.2 * without[1]).all()


def test_errors_ignore_the_drift_that_suits_a_frame_best() -> None:
    """And only as much of it as is asked for; the share that own drift explains says how much that is."""
    scene, rgb, _ = ring()
    fit = fit_of(scene, rgb)
    validation = Validation.of(fit)
    moved = [fit.median + 0.05 + 1.1 * (y - fit.median) for y in fit.data.images]
    exact, offset, none = (float(validation.errors(k, moved).sum()) for k in ("gain-offset", "offset", "off"))
    assert exact < 1e-3 * offset and offset < 0.9 * none
    assert validation.own_drift_share("off", moved) > 0.999 and validation.own_drift_share("gain-offset", moved) == 0.0


@pytest.mark.parametrize(
    ("after", "is_less"),
    [
        ([0.80, 0.90, 0.85], True),
        ([0.94, 0.96, 0.95], False),  # too little
        ([0.10, 0.99, 0.98], False),  # by one frame alone
        ([0.95, 0.95, 0.60], False),  # most frames gain too little
    ],
)
def test_clearly_less_is_in_the_mean_and_in_most_frames(after: list[float], is_less: bool) -> None:
    assert is_clearly_less(torch.tensor(after), torch.ones(3), 0.1) == is_less


def test_validation_frames_are_every_eighth() -> None:
    validation = Validation.of(fit_of(ring()[0], ring()[1]))
    assert list(validation.frames) == [4, 12, 20] and len(validation.others) == 25 and validation.surface is not None
    assert not set(validation.frames) & set(validation.others)


def test_a_split_names_the_validation_frames() -> None:
    fit = fit_of(ring()[0], ring()[1])
    names = fit.data.names
    validation = Validation.of(fit, Split(validation=frozenset({names[5], names[2], "elsewhere"})))
    assert list(validation.frames) == [2, 5] and validation.surface is None


@pytest.mark.parametrize(
    ("errors", "ends"),
    [
        ([[8.0, 9.0], [7.0, 8.0], [6.99, 7.99]], 3),  # no column falls by 2 % any more
        ([[8.0, 9.0], [7.0, 8.0], [6.99, 7.5], [6.98, 7.49]], 4),  # the one behind still fell, and might have won
        ([[8.0, 7.0], [7.0, 6.99], [6.5, 6.98], [6.0, 6.97]], None),  # the best one still falls
        ([[8.0, 9.0], [8.1, 9.5]], 2),  # errors rise
    ],
)
def test_iterations_end_when_no_error_falls_any_more(errors: list[list[float]], ends: int | None) -> None:
    stopping = EarlyStopping(Validation(fit_of(ring()[0], ring()[1]), [4]), ["off", "off"], 0.02)
    settled = [stopping.is_enough(torch.tensor(e)) for e in errors]
    assert settled == [turn + 1 == ends for turn in range(len(errors))]


def test_early_stopping_measures_the_unknowns_it_is_given() -> None:
    fit = fit_of(ring()[0], ring()[1])
    validation = Validation(fit, [4, 12])
    stopping = EarlyStopping(validation, ["off", "offset"], 0.02)
    x = fit.coverage.prior[:, None].expand(-1, 2)
    assert not stopping(x)
    images = {f: fit.design.image(f, x[:, :1])[..., 0] for f in (4, 12)}
    expected = torch.stack([validation.errors("off", images).sum(), validation.errors("offset", images).sum()])
    torch.testing.assert_close(stopping.errors, expected)
    assert stopping(x)  # nothing has moved
