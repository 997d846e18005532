"""What a synthetic capture draws at random: one stream of numbers for each purpose."""

from __future__ import annotations

import zlib

import numpy as np

from rtgs.config import SynthConfig

SFM_PER_METRE_RANGE = (0.05, 20.0)  # drawn log-uniformly from here unless the config names one


def rig_rng(config: SynthConfig, purpose: str, index: int = 0) -> np.random.Generator:
    """A stream of what the rig's own seed draws, where there is one: RGB images and poses stay the same."""
    if config.rig_seed is None:
        return rng(config, purpose, index)
    return np.random.default_rng([config.seed, zlib.crc32(f"{config.scene}/{purpose}".encode()), index, config.rig_seed])


def rng(config: SynthConfig, purpose: str, index: int = 0) -> np.random.Generator:
    """Its own stream for each purpose: switching one option on leaves the others' draws alone."""
    return np.random.default_rng([config.seed, zlib.crc32(f"{config.scene}/{purpose}".encode()), index])


def sfm_per_metre_of(config: SynthConfig) -> float:
    """The config's own, or one drawn log-uniformly with its seed."""
    if config.sfm_per_metre is not None:
        return config.sfm_per_metre
    low, high = np.log(SFM_PER_METRE_RANGE)
    return float(np.exp(rng(config, "unit").uniform(low, high)))
