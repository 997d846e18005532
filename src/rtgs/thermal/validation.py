"""Errors on validation frames: training frames that are left out of the fit while models are compared."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from rtgs.config import DriftKind
from rtgs.records.capture import Split
from rtgs.thermal.drift import estimate_drift
from rtgs.thermal.fit import Fit


@dataclass(frozen=True, eq=False)
class Validation:
    """The validation frames of a fit, V of F, and the errors of models on them.

    A validation frame's own offset and gain are unknown, because the frame is not fitted. Models are therefore compared by differences
    *within* frames: by the error after the offset (or gain and offset) that suits the frame best.

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

    def errors(
        self, kind: DriftKind, images: Mapping[int, Tensor] | Sequence[Tensor], among: Sequence[Tensor] | None = None
    ) -> Tensor:
        """`[V]`: Σ over pixels of |photograph − what the frame shows of the image|, with the drift that suits the frame best.

        Args:
            kind: what the best drift consists of; "off": no drift is subtracted.
            images: `[h, w]` of at least the validation frames, by index.
            among: `[h, w]` for each frame of the fit: how much each pixel counts in the sum; None: all alike. The drift is that of all.
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
        if among is not None:
            left = left * torch.stack([among[f] for f in self.frames])
        return (valid * left.abs()).sum((1, 2))

    def own_drift_share(self, kind: DriftKind, images: Sequence[Tensor]) -> float:
        """Share of the error under `kind` that offsets and gains of the validation frames' own would explain, from 0 to 1."""
        with_own, without = (float(self.errors(k, images).sum()) for k in ("gain-offset", kind))
        return max(1.0 - with_own / max(without, 1e-30), 0.0)

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
    """Ends a multi-right-hand-side solve when another iteration does little for the error on validation frames.

    That is when an iteration lowers the error of no column by `share` or more.

    Args:
        kinds: of drift, one for each column.
        share: of an error.

    Attributes:
        errors: `[C]`, Σ of the errors on validation frames after the last iteration.
    """

    def __init__(self, validation: Validation, kinds: Sequence[DriftKind], share: float) -> None:
        self.errors = torch.full((len(kinds),), math.inf)
        self._validation, self._kinds, self._share = validation, kinds, share

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
        before, self.errors = self.errors, errors
        return bool((errors > (1.0 - self._share) * before).all())
