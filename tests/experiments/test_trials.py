"""Trials of a scene: the same photographs, another rig and another noise."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.helpers.tiny_experiment import CONFIG

from rtgs.experiments.tasks import scene_config
from rtgs.experiments.trials import Trial
from rtgs.experiments.variants import PERTURBATIONS, REFERENCE_ROW, groups
from rtgs.synthetic import compiled_scene
from rtgs.synthetic.camera_path import camera_path
from rtgs.synthetic.rig import true_rig, written_rig
from rtgs.synthetic.sensor import noise_rng


@pytest.mark.thorough
def test_a_wrong_length_moves_the_curve_and_nothing_else(trial: Trial) -> None:
    """So descents under it are replayed on the curves of the true length."""
    clean = trial.temperatures(None)
    row = next(v for v in PERTURBATIONS if v.key == "length_2")
    assert row in next(g for g in groups(PERTURBATIONS) if REFERENCE_ROW in g)
    true, wrong = trial.scene(REFERENCE_ROW, clean), trial.scene(row, clean)
    model, name = trial.model, true.train_frames[0].name
    a, b = true.thermal_from_world(name, 1.02 * trial.truth), wrong.thermal_from_world(name, trial.truth)
    assert np.allclose(a.matrix(), b.matrix(), atol=1e-12) and row.length_factor == pytest.approx(1.02)
    assert model is trial.model


def test_seeds_share_the_photographs_and_differ_in_the_rig() -> None:
    configs = [replace(scene_config(CONFIG, "lego"), rig_seed=k) for k in (None, 0, 1)]
    centre = compiled_scene("lego").model.centre
    paths = [np.stack([p.matrix() for p in camera_path(c, centre)]) for c in configs]
    assert np.array_equal(paths[0], paths[1]) and np.array_equal(paths[0], paths[2])
    rigs = [true_rig(c) for c in configs]
    poses = [r.rgb_from_thermal for r in rigs]
    assert all(r.rgb == rigs[0].rgb and r.thermal == rigs[0].thermal for r in rigs)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert np.linalg.norm(poses[i].translation - poses[j].translation) > 0.01
        assert np.abs(poses[i].rotation - poses[j].rotation).max() > 1e-3
    assert all(np.linalg.norm(p.translation) == pytest.approx(0.2) for p in poses)
    assert not np.array_equal(noise_rng(configs[1], 0).normal(size=9), noise_rng(configs[2], 0).normal(size=9))
    tilted = [written_rig(replace(c, rig_direction_error=0.02), r) for c, r in zip(configs, rigs, strict=True)]
    for told, true in zip(tilted, poses, strict=True):
        apart = told.rgb_from_thermal.translation - true.translation
        assert np.linalg.norm(apart) == pytest.approx(0.004, rel=0.01)


def test_the_object_stays_in_view() -> None:
    """Whatever side the thermal camera sits on, the object's centre is near the middle of its picture."""
    for seed in range(20):
        config = replace(scene_config(CONFIG, "chair"), rig_seed=seed)
        rig, centre = true_rig(config), compiled_scene("chair").model.centre
        for pose in camera_path(config, centre):
            x, y, z = (pose @ rig.rgb_from_thermal).inverse().apply(np.array(centre))
            assert z > 0 and math.hypot(x, y) / z < math.tan(math.radians(8))
