"""What a thermal sensor adds to its images."""

from __future__ import annotations

import numpy as np


def sensor_stripes(rng: np.random.Generator, shape: tuple[int, int], size: float) -> np.ndarray:
    """Readout noise of rows and columns, and vignetting."""
    y, x = (np.linspace(-1, 1, n) for n in shape)
    return size * (rng.normal(size=(shape[0], 1)) + rng.normal(size=(1, shape[1])) - 3 * (x[None] ** 2 + y[:, None] ** 2))
