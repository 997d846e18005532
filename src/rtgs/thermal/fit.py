"""The fit's common state: photographs, design matrix and prior, and the least-squares problems that are posed with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from rtgs.config import DriftKind
from rtgs.images.patterns import quadratic_terms, sensor_pattern
from rtgs.thermal.coverage import Coverage, measure_coverage, ridge
from rtgs.thermal.design import Design
from rtgs.thermal.drift import Drift, estimate_drift, in_gauge
from rtgs.thermal.frames import ThermalFrames
from rtgs.thermal.least_squares import Problem, preconditioner
from rtgs.thermal.settings import LinearSettings


@dataclass(frozen=True, eq=False)
class Fit:
    """What stays the same while a capture is fitted.

    Attributes:
        data: the F photographs, in units of the colours' range.
        median: the scene's median, about which gains stretch.
        each: called after each rendered view.
    """

    design: Design
    data: ThermalFrames
    coverage: Coverage
    median: float
    settings: LinearSettings
    each: Callable[[], None]

    @staticmethod
    def of(design: Design, data: ThermalFrames, settings: LinearSettings, each: Callable[[], None] = lambda: None) -> Fit:
        """Measures coverage by one pass over the photographs."""
        median = float(torch.cat([i[data.valid > 0] for i in data.images]).median())
        return Fit(design, data, measure_coverage(design, data, settings, each), median, settings, each)

    @property
    def pixel_weights(self) -> list[Tensor]:
        """`[h, w]` for each frame: the weights before any pixel is doubted."""
        return [self.data.valid] * len(self.data)

    def problem(
        self,
        factors: Sequence[float],
        frames: Sequence[int],
        *,
        drift: tuple[DriftKind, Drift] | None = None,
        offsets: Tensor | None = None,
        surface: Tensor | None = None,
        surfaces: Tensor | None = None,
    ) -> Problem:
        """Least squares on some frames, one column for each ridge factor.

        Args:
            drift: the kind of drift in all columns. Its gains count as known; offsets are unknowns that the solver eliminates.
            offsets: `[C]`, which columns have offsets, instead of `drift`.
            surface, surfaces: as in `Problem`.
        """
        weights = self.pixel_weights
        photographs = [y[..., None] for y in self.data.images]
        if drift is not None and drift[0] == "gain-offset":
            gains = drift[1].gain
            photographs = [self.median + (y - self.median) / gains[f] for f, y in enumerate(photographs)]
            weights = [w * gains[f] ** 2 for f, w in enumerate(weights)]
        pixels = self.coverage.pixels
        ridges = torch.stack([ridge(self.design, pixels, f, self.settings) for f in factors], dim=1)
        inverses, background = preconditioner(
            self.coverage.blocks, float(pixels[-1]), ridges.log().mean(dim=1).exp(), self.design
        )
        prior = self.coverage.prior[:, None].expand(-1, len(factors))
        if drift is not None and drift[0] != "off":
            offsets = torch.ones(len(factors))
        return Problem(
            design=self.design,
            frames=frames,
            images=photographs,
            weights=weights,
            offsets=offsets,
            ridge=ridges,
            prior=prior,
            inverses=inverses,
            background=background,
            surface=surface,
            surfaces=surfaces,
        )

    def images(self, x: Tensor) -> list[Tensor]:
        """`[h, w, C]` for each frame, of unknowns `[D, C]`."""
        out = []
        for image in self.design.each(lambda f: self.design.image(f, x), range(len(self.data))):
            out.append(image)
            self.each()
        return out

    def drift(self, kind: DriftKind, images: Sequence[Tensor], weights: Sequence[Tensor] | None = None) -> Drift:
        """The frames' drift at given images of the scene `[h, w]`, before the gauge is fixed."""
        weights = self.pixel_weights if weights is None else weights
        limits = self.settings.gain_limits
        return estimate_drift(kind, self.median, images, self.data.images, weights, gain_limits=limits)

    def gauged(self, kind: DriftKind, images: Sequence[Tensor]) -> tuple[DriftKind, Drift]:
        """The frames' drift in the gauge of `in_gauge`, as `problem` takes it."""
        return kind, in_gauge(self.drift(kind, images))[0]

    def residuals(self, drift: Drift, images: Sequence[Tensor]) -> list[Tensor]:
        """`[h, w]` for each frame: photograph − what the frame shows of the image."""
        return [y - drift.of(f, images[f]) for f, y in enumerate(self.data.images)]

    def pattern(self, kind: DriftKind, images: Sequence[Tensor], frames: Sequence[int]) -> Tensor:
        """`[h, w]`: the sensor's pattern, from the residuals of some frames. In residuals little is left of the scene itself."""
        left = self.residuals(self.drift(kind, images), images)
        stack = torch.stack([left[f] for f in frames])
        return torch.from_numpy(sensor_pattern(stack.numpy(), self.data.valid.numpy() > 0))

    def without(self, pattern: Tensor) -> Fit:
        """The same fit with a pattern subtracted from the photographs."""
        return replace(self, data=replace(self.data, images=tuple(y - pattern for y in self.data.images)))

    def on(self, other: Fit) -> Fit:
        """The same photographs, on the Gaussians of another fit."""
        return replace(other, data=self.data)

    def surface(self) -> Tensor:
        """`[h, w, 5]`: x, y, x², y², x·y with mean 0 over the valid pixels. Vignetting is nearly a combination of these."""
        terms = torch.from_numpy(quadratic_terms(tuple(self.data.valid.shape))[1:]).float()
        terms = terms - (terms * self.data.valid).sum((1, 2), keepdim=True) / self.data.valid.sum()
        return (terms * (self.data.valid > 0)).permute(1, 2, 0).contiguous()


@dataclass(frozen=True, eq=False)
class Fitted:
    """A solution with its images.

    Attributes:
        x: `[D, 1]`, the unknowns.
        images: `[h, w]` for each frame.
    """

    x: Tensor
    images: Sequence[Tensor]

    @staticmethod
    def of(fit: Fit, x: Tensor) -> list[Fitted]:
        """One for each column of x `[D, C]`."""
        images = fit.images(x)
        return [Fitted(x[:, c : c + 1].clone(), [i[..., c] for i in images]) for c in range(x.shape[1])]
