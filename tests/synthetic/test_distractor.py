"""The distractor stands in training frames alone, one of ten, at places that vary."""

from __future__ import annotations

import numpy as np
import pytest

from rtgs.records.capture import Split
from rtgs.synthetic import SynthConfig
from rtgs.synthetic.capture import frame_names
from rtgs.synthetic.distractor import Distractor, draw_distractors
from rtgs.synthetic.rig import true_rig


def test_one_training_frame_of_ten_has_it_at_places_that_vary() -> None:
    config = SynthConfig(frames=40, size=100, seed=2)
    camera, names = true_rig(config).thermal, frame_names(config)
    found = draw_distractors(config, camera, names)
    assert len(found) == 4
    assert [names.index(name) // 10 for name in found] == [0, 1, 2, 3]
    assert not set(found) & Split().held_out_names(names)
    places = np.array([d.centre_px for d in found.values()])
    assert (places >= 20).all() and (places <= 80).all() and np.ptp(places, axis=0).min() > 5
    assert found == draw_distractors(config, camera, names)


def test_its_area_and_height_are_those_of_the_ellipse() -> None:
    camera = true_rig(SynthConfig(size=100)).thermal
    image = Distractor((50.0, 40.0), (6.0, 12.0), 0.3, 15.0).excess(camera)
    assert image.max() == 15.0 and image[0, 0] == 0.0
    assert image.sum() / 15.0 == pytest.approx(np.pi * 6 * 12, rel=0.02)
    y, x = np.nonzero(image > 7.5)
    assert (x.mean() + 0.5, y.mean() + 0.5) == pytest.approx((50.0, 40.0), abs=0.1)
