"""What the sensor makes of the scene: its pattern, and drift of frames that were not fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.thermal_scenes import RIG, SFM_PER_METRE, fitted_ring, ring

from rtgs.base.errors import RtgsError
from rtgs.models import SensorModel
from rtgs.models.sensor import predicted_drift


def test_a_pattern_belongs_to_its_sensor() -> None:
    model = replace(fitted_ring(), sensor=SensorModel(pattern=np.full((RIG.thermal.height, RIG.thermal.width), 0.25, np.float32)))
    pose = ring()[0].thermal_from_world("003", SFM_PER_METRE)
    plain = fitted_ring().render(RIG.thermal, pose)
    np.testing.assert_allclose(model.render(RIG.thermal, pose), plain)
    np.testing.assert_allclose(model.render(RIG.thermal, pose, photographed_in="003"), plain + 0.25, atol=1e-4)
    with pytest.raises(RtgsError, match="pattern"):
        model.render(RIG.thermal.resized(16, 16), pose, photographed_in="003")


def test_a_held_out_frame_has_the_drift_of_its_neighbours_as_far_as_they_agree() -> None:
    slow = np.sin(np.arange(40) / 6.0)[:, None] * (0.0, 2.0)
    between_them = predicted_drift(slow, slow[:, 1], 11)
    assert between_them[1] == pytest.approx(slow[10:12, 1].mean(), rel=0.06) and between_them[0] == 0.0
    wild = np.random.default_rng(1).normal(size=(400, 2))
    assert np.abs(predicted_drift(wild, wild[:, 1], 200)).max() < 0.15
    assert predicted_drift(slow, slow[:, 1], 0)[1] == pytest.approx(slow[0, 1], abs=0.1)
    assert predicted_drift(slow, slow[:, 1], 40)[1] == pytest.approx(slow[39, 1], rel=0.06)
