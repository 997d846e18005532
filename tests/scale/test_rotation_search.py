"""The search over rotation and focal length finds a planted one, without a start near it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.scale_scenes import sequence
from tests.helpers.unknown_rig import apart_deg, unknown

from rtgs.maths.geometry import SE3
from rtgs.scale.objective import scaled_thermal
from rtgs.scale.progress import RenderProgress
from rtgs.scale.rotation_search import rotation_candidates


@pytest.mark.thorough
@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (6.0, -7.0, 5.0), (-9.0, 4.0, -10.0)])
def test_a_planted_rotation_is_among_the_first(turned: tuple[float, float, float]) -> None:
    scene, model = sequence()
    hidden = unknown(scene, turned=turned, zoom=0.93)
    frames = scene.train_frames[::2]
    thermal = scaled_thermal({f.name: f.thermal for f in frames}, scene.capture.thermal_mask)
    found = rotation_candidates(hidden, model, frames, thermal, RenderProgress(None), most=3)
    assert [c.agreement for c in found] == sorted((c.agreement for c in found), reverse=True)
    # The baseline looks like a turn: 0.18 m at 2.6 m are 4°.
    for candidate in found[:1]:
        pose = SE3(candidate.rotation, np.ones(3))
        assert apart_deg(replace(scene.rig, rgb_from_thermal=pose), scene.rig) < 6.0
        assert abs(candidate.zoom * 0.93 - 1) < 0.06
