"""What a synthetic capture draws at random: one stream of numbers for each purpose."""

from __future__ import annotations

import zlib

import numpy as np

from rtgs.config import SynthConfig

SFM_PER_METRE_RANGE = (0.05, 20.0)  # drawn log-uniformly from here unless the config names one


def rig_rng(config: SynthConfig, purpose: str, index: int = 0) -> np.random.Generator:
    """Random numbers for the rig and what it records, drawn with `rig_seed` where there is one.

    Captures that differ in `rig_seed` alone have the same RGB images and poses.
    """
    if config.rig_seed is None:
        return rng(config, purpose, index)
    return np.random.default_rng([config.seed, zlib.crc32(f"{config.scene}/{purpose}".encode()), index, config.rig_seed])


def rng(config: SynthConfig, purpose: str, index: int = 0) -> np.random.Generator:
    """Random numbers for one purpose. Each purpose has a stream of its own, so an option changes no draw of another one."""
    return np.random.default_rng([config.seed, zlib.crc32(f"{config.scene}/{purpose}".encode()), index])


def sfm_per_metre_of(config: SynthConfig) -> float:
    """The unit of the written poses: the config's own, or one drawn log-uniformly with its seed."""
    if config.sfm_per_metre is not None:
        return config.sfm_per_metre
    low, high = np.log(SFM_PER_METRE_RANGE)
    return float(np.exp(rng(config, "unit").uniform(low, high)))
