"""Counts and degrees Celsius."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class CountsToCelsius:
    """A sensor's linear scale: `temperature_c = count · celsius_per_count + celsius_offset`."""

    celsius_per_count: float
    celsius_offset: float

    def celsius(self, counts: NDArray[np.generic]) -> NDArray[np.float32]:
        """°C of counts of any shape; computed in float64, since 16-bit counts times 0.01 lose digits in float32."""
        return (counts.astype(np.float64) * self.celsius_per_count + self.celsius_offset).astype(np.float32)

    def counts(self, temperature_c: NDArray[np.floating]) -> NDArray[np.float64]:
        """The inverse, not rounded."""
        return (temperature_c.astype(np.float64) - self.celsius_offset) / self.celsius_per_count


CENTIKELVIN = CountsToCelsius(celsius_per_count=0.01, celsius_offset=-273.15)


@dataclass(frozen=True)
class LinearRange:
    """A stored linear normalisation: `lo` is 0, `hi` is 1; nothing is clipped.

    Thermal colours, and thermal PSNR and SSIM, are in these units; `lo` and `hi` are °C (or counts, for a relative capture).
    """

    lo: float
    hi: float

    def normalise(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        return ((values.astype(np.float64) - self.lo) / (self.hi - self.lo)).astype(np.float32)

    def expand(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        return (values.astype(np.float64) * (self.hi - self.lo) + self.lo).astype(np.float32)
