"""When a scale is called ambiguous or unobservable."""

from __future__ import annotations

import pytest
from tests.helpers.scale_scenes import (
    GLOBAL,
    facing_walls,
)

from rtgs.scale import estimate_scale


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_a_far_wall_tells_nothing_and_says_so(noise: float) -> None:
    scene, model = facing_walls(400.0, None, noise)  # the baseline moves the picture by 0.03 px
    estimate = estimate_scale(scene, model, GLOBAL)
    assert estimate.status == "unobservable" and "below" in estimate.reason
    near = estimate_scale(*facing_walls(2.0, None, noise), GLOBAL)
    assert near.status == "ok" and near.sfm_per_metre == pytest.approx(1.0, rel=0.02)


def test_a_picket_fence_is_ambiguous() -> None:
    # 0.2 m at 2 m is 6.4 px; four columns of the wall are 10.4 px, so 16.8 px fit as well: no edge of the wall is in view.
    estimate = estimate_scale(*facing_walls(2.0, 4, 1.0), GLOBAL)
    assert estimate.status == "ambiguous", estimate
    everything = [estimate.sfm_per_metre, *(m.sfm_per_metre for m in estimate.minima)]
    assert min(abs(s - 1.0) for s in everything) < 0.03
    assert any(m.chance > 0.025 for m in estimate.minima) and f"{estimate.minima[0].sfm_per_metre:.4g}" in estimate.reason
