"""Photographs as the thermal fit takes them, and the range of a capture."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.helpers.thermal_scenes import SFM_PER_METRE, ring

from rtgs.thermal import training_range
from rtgs.thermal.certainty import Variance
from rtgs.thermal.frames import ThermalFrames, outer_percentiles


@pytest.mark.parametrize("percentile", [0.0, 0.1, 3.0, 20.0])
@pytest.mark.parametrize(("parts", "each"), [(1, 1), (1, 7), (3, 1), (11, 400), (40, 1234)])
def test_percentiles_of_parts_are_those_of_the_whole(parts: int, each: int, percentile: float) -> None:
    """To the last bit, ties included."""
    rng = np.random.default_rng(parts * each)
    values = [np.round(rng.normal(20, 8, each), rng.integers(1, 6)).astype(np.float32) for _ in range(parts)]
    expected = np.percentile(np.concatenate(values), [percentile, 100 - percentile])
    assert outer_percentiles(iter(values), parts * each, percentile) == tuple(expected.tolist())


def test_images_are_made_when_they_are_asked_for() -> None:
    """As they are with all images in memory; some of the frames are evenly spaced ones."""
    scene = ring()[0]
    data = ThermalFrames.of(scene, scene.train_frames, SFM_PER_METRE, training_range(scene))
    kept = data.rows(1)
    assert data.images[0] is not data.images[0] and kept.images[0] is kept.images[0]
    for made, there in zip(data.images, kept.images, strict=True):
        assert torch.equal(made, there)
    few = data.some(3)
    assert few.names == (data.names[0], data.names[round((len(data) - 1) / 2)], data.names[-1]) and len(few.poses) == 3
    assert torch.equal(few.images[2], kept.images[-1]) and data.some(len(data) + 5) is data


def test_the_variance_of_parts() -> None:
    parts = [20 + torch.randn(n, generator=torch.Generator().manual_seed(n)) for n in (1, 50, 3)]
    found = Variance()
    for part in parts:
        found.add(part)
    assert found.value == pytest.approx(float(torch.cat(parts).double().var()), rel=1e-12)
