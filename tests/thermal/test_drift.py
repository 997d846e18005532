"""Drift of the photographs: estimated, in its gauge."""

from __future__ import annotations

import pytest
import torch

from rtgs.thermal.drift import Drift, estimate_drift, in_gauge


def test_gauge() -> None:
    g = torch.Generator().manual_seed(0)
    images = [torch.rand(9, 7, generator=g) for _ in range(5)]
    drift = Drift(0.4, torch.tensor([0.8, 1.1, 1.3, 1.2, 0.9]), torch.tensor([0.1, -0.3, 0.2, 0.4, 0.0]))
    photographs = [drift.of(f, i) for f, i in enumerate(images)]
    found = estimate_drift("gain-offset", 0.4, images, photographs, [torch.ones(9, 7)] * 5, gain_limits=(0.5, 2.0))
    torch.testing.assert_close(found.gain, drift.gain, atol=1e-4, rtol=0)
    torch.testing.assert_close(found.offset, drift.offset, atol=1e-4, rtol=0)
    fixed, gain, offset = in_gauge(drift)
    assert float(fixed.gain.log().median()) == pytest.approx(0.0, abs=1e-6)
    assert float(fixed.offset.median()) == pytest.approx(0.0, abs=1e-6)
    for f, image in enumerate(images):  # photographs stay what they were
        torch.testing.assert_close(fixed.of(f, 0.4 + offset + gain * (image - 0.4)), photographs[f], atol=1e-6, rtol=0)
