"""Errors on validation frames: training frames that are left out of the fit while models are compared."""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from rtgs.models.sensor import predicted_drift
from rtgs.records.capture import Split
from rtgs.thermal.drift import DriftKind, estimate_drift, in_gauge
from rtgs.thermal.fit import Fit


@dataclass(frozen=True, eq=False)
class Validation:
    """The validation frames of a fit, V of F, and the errors of models on them.

    A validation frame's own offset and gain are unknown, because the frame is not fitted. Models are therefore compared by differences
    *within* frames: by the error after the offset (or gain and offset) that suits the frame best. `level_error` looks at levels.

    Attributes:
        frames: indices of the validation frames.
        surface: `[h, w, B]`: the combination of these terms that suits all validation frames best is no error; None: no surface.
    """

    fit: Fit
    frames: Sequence[int]
    surface: Tensor | None = None

    @staticmethod
    def of(fit: Fit, split: Split | None = None) -> Validation:
        """The frames that a split names, with the common surface (`Fit.surface`) where they are enough to decide about a pattern."""
        names = (split or Split()).validation_names(fit.data.names)
        frames = [i for i, name in enumerate(fit.data.names) if name in names]
        return Validation(fit, frames, fit.surface() if len(frames) >= fit.settings.fewest_frames else None)

    @property
    def others(self) -> list[int]:
        """Indices of the frames that are fitted."""
        return [f for f in range(len(self.fit.data)) if f not in self.frames]

    @property
    def is_enough(self) -> bool:
        """Whether there are enough validation frames to decide about drift and pattern."""
        return len(self.frames) >= self.fit.settings.fewest_frames

    def without_surface(self) -> Validation:
        return replace(self, surface=None)

    def errors(self, kind: DriftKind, images: Mapping[int, Tensor] | Sequence[Tensor]) -> Tensor:
        """`[V]`: Σ over pixels of |photograph − what the frame shows of the image|, with the drift that suits the frame best.

        Args:
            kind: what the best drift consists of; "off": no drift is subtracted.
            images: `[h, w]` of at least the validation frames, by index.
        """
        valid = self.fit.data.valid
        photographs, shown = [self.fit.data.images[f] for f in self.frames], [images[f] for f in self.frames]
        if kind != "off":
            weights, limits = [valid] * len(shown), self.fit.settings.gain_limits
            drift = estimate_drift(kind, self.fit.median, shown, photographs, weights, gain_limits=limits)
            shown = [drift.of(f, image) for f, image in enumerate(shown)]
        left = torch.stack([y - image for y, image in zip(photographs, shown, strict=True)])
        if self.surface is not None:
            left = left - _best_surface(self.surface, left, valid)
        return (valid * left.abs()).sum((1, 2))

    def level_error(self, kind: DriftKind, images: Sequence[Tensor]) -> float:
        """Σ of errors on the validation frames with drift predicted from their neighbours, as for a held-out frame.

        Args:
            images: `[h, w]` of all frames.
        """
        fit = self.fit
        drift, gain, offset = in_gauge(fit.drift(kind, images).only(self.others))
        away = torch.stack([drift.gain - 1.0, drift.offset], dim=1).double().numpy()
        shown = {}
        for f in self.frames:
            own_gain, own_offset = predicted_drift(away, away[:, 1], bisect(self.others, f))
            scene = gain * (images[f] - fit.median) + offset
            shown[f] = fit.median + float(own_offset) + (1.0 + float(own_gain)) * scene
        return float(self.errors("off", shown).sum())

    def own_drift_share(self, kind: DriftKind, images: Sequence[Tensor]) -> float:
        """Share of the error under `kind` that gains and offsets of the validation frames' own would explain."""
        return 1.0 - float(self.errors("gain-offset", images).sum()) / max(float(self.errors(kind, images).sum()), 1e-30)

    def mean(self, errors: Tensor) -> float:
        """Mean absolute error of a pixel, in units of the range, of `errors` `[V]`."""
        return float(errors.sum()) / (len(self.frames) * float(self.fit.data.valid.sum()))


def _best_surface(surface: Tensor, left: Tensor, valid: Tensor) -> Tensor:
    """`[h, w]`: the combination of `surface` `[h, w, B]` that is closest to the mean over frames of `left` `[V, h, w]`."""
    terms = surface.flatten(0, 1)
    weighted = (valid.flatten()[:, None] * terms).T
    amounts = torch.linalg.pinv(weighted @ terms, hermitian=True) @ (weighted @ left.mean(0).flatten())
    return (terms @ amounts).view_as(valid)


def is_clearly_less(errors: Tensor, before: Tensor, share: float) -> bool:
    """Whether errors `[V]` on validation frames are clearly less than `before`.

    Their mean must be less by this share and by more than one standard error, and more than half of the frames must gain by the share:
    a single frame must not decide.
    """
    gain = before - errors
    standard_error = float(gain.std()) / len(gain) ** 0.5
    median_share = (gain / before.clamp_min(1e-12)).quantile(0.5)
    return float(gain.mean()) > max(share * float(before.mean()), standard_error) and float(median_share) > share


class EarlyStopping:
    """Ends a multi-right-hand-side solve when more iterations do little for the error on validation frames.

    A column is settled when its error falls by less than `share` over the last `stop_after` iterations. All columns must be settled,
    except those that would stay behind the best even if they fell by as much again: what is ahead now need not be ahead in the end.

    Args:
        kinds: of drift, one for each column.
        share: of an error.

    Attributes:
        errors: `[C]`, Σ of the errors on validation frames after the last iteration.
    """

    def __init__(self, validation: Validation, kinds: Sequence[DriftKind], share: float) -> None:
        self.errors = torch.zeros(len(kinds))
        self._validation, self._kinds, self._share = validation, kinds, share
        self._after = validation.fit.settings.stop_after
        self._history = [torch.full((len(kinds),), math.inf)] * self._after

    def __call__(self, x: Tensor) -> bool:
        """`settled` of a solver: whether unknowns `[D, C]` are good enough."""
        frames, design = self._validation.frames, self._validation.fit.design
        images = list(design.each(lambda f: design.image(f, x), frames))
        errors = torch.zeros(len(self._kinds))
        for c, kind in enumerate(self._kinds):
            errors[c] = self._validation.errors(kind, {f: i[..., c] for f, i in zip(frames, images, strict=True)}).sum()
        return self.is_enough(errors)

    def is_enough(self, errors: Tensor) -> bool:
        """Whether to stop after another iteration led to these errors `[C]`."""
        self.errors = errors
        self._history.append(errors)
        fall = self._history[-1 - self._after] - errors
        is_behind = errors - fall > errors.min()
        return bool((is_behind | (fall < self._share * (errors + fall))).all())
