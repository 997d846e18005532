"""The thermal sensor of a synthetic capture: from clean °C to the counts of its files."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.config import SynthConfig
from rtgs.records.radiometry import CountsToCelsius
from rtgs.synthetic.draws import rig_rng

RADIOMETRY = CountsToCelsius(celsius_per_count=0.01, celsius_offset=-100.0)


def record_thermal(
    clean_c: NDArray[np.float32], config: SynthConfig, gain: float, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """`[H, W]` °C to 16-bit counts: lens blur, sensor noise, gain about the image's mean, rounding."""
    image: NDArray[Any] = clean_c.astype(np.float64)
    if config.blur_px > 0:
        image = cv2.GaussianBlur(image, (0, 0), config.blur_px, borderType=cv2.BORDER_REPLICATE)
    image = image + config.netd_c * rng.standard_normal(image.shape)
    image = image.mean() + gain * (image - image.mean())
    return np.clip(np.rint(RADIOMETRY.counts(image)), 0, 65535).astype(np.uint16)


def contrast_gains(config: SynthConfig) -> NDArray[np.float64]:
    """`[frames]`: what each thermal image's contrast about its mean is multiplied by."""
    return 1 + config.gain_jitter * rig_rng(config, "gain").uniform(-1, 1, config.frames)


def noise_rng(config: SynthConfig, frame: int) -> np.random.Generator:
    """The random numbers of one thermal image's noise."""
    return rig_rng(config, "noise", frame)
