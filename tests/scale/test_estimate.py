"""The whole stage: what every solver has in common, what is refused, and the record."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import torch
from tests.helpers.scale_scenes import GLOBAL, QUICK, assembled, sequence, synthetic

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import from_json, to_json
from rtgs.config import ScaleConfig
from rtgs.config.scale import SolverName
from rtgs.maths.geometry import Sim3
from rtgs.scale import ScaleEstimate, estimate_scale
from rtgs.scale.solvers import SOLVERS


def through_json(estimate: ScaleEstimate) -> ScaleEstimate:
    return from_json(ScaleEstimate, json.loads(json.dumps(to_json(estimate), allow_nan=False)), "scale.json")


def test_the_same_call_gives_the_same_estimate_and_held_out_images_do_not_matter() -> None:
    scene, model = synthetic()
    config = replace(QUICK, init=1.3, steps=10)
    held_out = {f.name for f in scene.held_out_frames}
    assert held_out == {"000"}
    spoiled = assembled(
        list(scene.world_from_rgb.values()),
        [f.thermal[::-1].copy() * 100 if f.name in held_out else f.thermal for f in scene.frames],
    )
    changed = assembled(
        list(scene.world_from_rgb.values()),
        [f.thermal[::-1].copy() if f.name == "001" else f.thermal for f in scene.frames],
    )
    first, again, without, other = (
        json.dumps(to_json(estimate_scale(s, model, config))) for s in (scene, scene, spoiled, changed)
    )
    assert first == again == without
    assert first != other  # a training image does matter


@pytest.mark.thorough
@pytest.mark.parametrize(
    "config",
    [replace(QUICK, init=1.3, steps=10), replace(GLOBAL, refine=("focal",))],
    ids=lambda c: c.solver,
)
def test_the_scale_is_in_the_unit_of_the_given_poses(config: ScaleConfig) -> None:
    """The same world, said to be in a unit 50 times smaller: every scale is 50 times as large, and nothing else changes."""
    scene, model = synthetic()
    small = replace(scene, given_from_world=Sim3(50.0, np.eye(3), np.array([1e7, 0.0, -3e6])))
    first = estimate_scale(scene, model, config)
    second = estimate_scale(small, model, replace(config, init=None if config.init is None else 50 * config.init))
    assert second.sfm_per_metre == pytest.approx(50 * first.sfm_per_metre, rel=1e-5)
    assert first.ci95 is not None and second.ci95 == pytest.approx([50 * s for s in first.ci95], rel=1e-4)
    assert second.bracket == pytest.approx([50 * s for s in first.bracket])
    assert second.std_log == pytest.approx(first.std_log, rel=1e-3) and second.status == first.status
    assert second.history.sfm_per_metre == pytest.approx([50 * s for s in first.history.sfm_per_metre], rel=1e-5)
    assert second.history.slope == pytest.approx(first.history.slope, rel=1e-3, abs=1e-6)
    if first.refinement is not None and second.refinement is not None:
        assert second.refinement.fl_x == pytest.approx(first.refinement.fl_x, rel=1e-5)


def test_json_round_trip() -> None:
    scene, model = synthetic()
    for config in (replace(QUICK, steps=2, scan_samples=4), replace(QUICK, steps=2, init=1.0)):
        estimate = estimate_scale(scene, model, config)
        text = json.dumps(to_json(estimate), allow_nan=False)
        data = json.loads(text)
        assert {"sfm_per_metre", "metres_per_sfm", "std_log", "ci95", "status"} <= set(data)
        assert data["metres_per_sfm"] == pytest.approx(1 / estimate.sfm_per_metre)
        assert from_json(ScaleEstimate, data, "scale.json") == estimate


@pytest.mark.thorough
def test_the_record_survives_json() -> None:
    scene, model = sequence()
    estimate = estimate_scale(scene, model, ScaleConfig(solver="global", init=1.0, refine=("focal", "time-offset")))
    back = through_json(estimate)
    assert back == estimate and back.refinement is not None
    assert [f.name for f in back.refinement.freedoms] == ["thermal focal length", "time offset"]
    assert back.refined_scene(scene).rig == estimate.refined_scene(scene).rig or np.allclose(
        back.refined_scene(scene).rig.rgb_from_thermal.matrix(), estimate.refined_scene(scene).rig.rgb_from_thermal.matrix()
    )
    old = {k: v for k, v in to_json(estimate).items() if k != "refinement"}
    assert from_json(ScaleEstimate, old, "scale.json").refined_scene(scene) is scene


def test_progress_counts_every_render() -> None:
    scene, model = synthetic()
    seen: list[tuple[int, int]] = []
    config = replace(QUICK, steps=2, scan_samples=3, batch=2)
    estimate_scale(scene, model, config, progress=lambda done, total, _: seen.append((done, total)))
    assert [done for done, _ in seen] == list(range(1, len(seen) + 1))
    assert seen[-1][0] == seen[-1][1]


def test_progress_of_the_search_ends_at_its_end() -> None:
    scene, model = synthetic()
    seen: list[tuple[int, int]] = []
    estimate = estimate_scale(scene, model, GLOBAL, progress=lambda done, total, _: seen.append((done, total)))
    assert [done for done, _ in seen] == list(range(1, len(seen) + 1))
    assert seen[-1][0] == seen[-1][1] == estimate.renders


def test_one_training_frame_says_nothing_about_its_error() -> None:
    scene, model = synthetic(1.0, 2)
    estimate = estimate_scale(scene, model, replace(QUICK, init=1.05, steps=3))
    assert estimate.frames == ("001",)
    assert estimate.std_log is None and estimate.ci95 is None
    assert through_json(estimate) == estimate


@pytest.mark.parametrize("init", [0.0, -1.0, float("nan"), float("inf")])
def test_a_start_that_is_no_scale_is_refused(init: float) -> None:
    with pytest.raises(RtgsError, match="init"):
        ScaleConfig(init=init)


@pytest.mark.parametrize("batch", [0, -3])
def test_a_batch_of_no_frames_is_refused(batch: int) -> None:
    with pytest.raises(RtgsError, match="batch"):
        ScaleConfig(batch=batch)


def test_nothing_to_compare_is_said() -> None:
    scene, model = synthetic()
    only_held_out = assembled([scene.world_from_rgb["000"]], [scene.frames[0].thermal])
    with pytest.raises(RtgsError, match="no training frame"):
        estimate_scale(only_held_out, model)
    empty = replace(model, gaussians=replace(model.gaussians, opacity_logits=torch.full((500,), -50.0)))
    with pytest.raises(RtgsError, match="covers no pixel"):
        estimate_scale(scene, empty)


def test_every_solver_that_settings_can_name_is_there() -> None:
    names: tuple[SolverName, ...] = get_args(SolverName)
    assert tuple(SOLVERS) == names
    for name in names:
        assert ScaleConfig(solver=name).solver == name
    with pytest.raises(RtgsError, match=r"solver is 'newton'; it is global or adam"):
        ScaleConfig(solver="newton")  # type: ignore[arg-type]
