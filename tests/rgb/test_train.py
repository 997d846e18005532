"""Training of the RGB model: it learns, keeps its budget, resumes, and never looks at held-out images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import torch
from tests.helpers.ball_scene import CAMERA, QUICK, RIG, assert_equal, held_out_psnr, synthetic, tensors
from tests.helpers.scene_record import altered, scene_of

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3
from rtgs.renderer import render
from rtgs.rgb.settings import NEAR_FRACTION
from rtgs.rgb.train import Training, fit_rgb


class Interrupted(Exception):
    pass


def test_training_improves_views_that_it_never_saw() -> None:
    scene = synthetic()
    start, model = fit_rgb(scene, replace(QUICK, steps=1)), fit_rgb(scene, QUICK)
    assert [f.name for f in scene.held_out_frames] == ["000", "008"]
    before, after = held_out_psnr(scene, start), held_out_psnr(scene, model)
    assert after > before + 5.0 and after > 22.0
    assert model.history["held_out_psnr"][-1] == pytest.approx(after, abs=1e-3)
    assert model.history["step"][-1] == QUICK.steps
    # It starts at the border's median, which is the background already, and at 2e-3 a step it may wander a little.
    np.testing.assert_allclose(model.background, [0.3, 0.35, 0.4], atol=0.05)
    assert model.settings.near_plane == NEAR_FRACTION * scene.steady().extent
    assert all(torch.isfinite(t).all() and not t.requires_grad for t in tensors(model).values())


def test_the_same_call_gives_the_same_model_and_held_out_images_do_not_matter() -> None:
    scene, config = synthetic(), replace(QUICK, steps=50)
    noise = {f.name: 1.0 - f.rgb[::-1].copy() for f in scene.held_out_frames}
    first = fit_rgb(scene, config)
    assert_equal(first, fit_rgb(scene, config))
    without = fit_rgb(altered(scene, rgb=noise), config)
    assert_equal(first, without)
    assert without.history["held_out_psnr"] != first.history["held_out_psnr"]  # scored, for show
    other = fit_rgb(altered(scene, rgb={"003": 1.0 - scene.frames[3].rgb}), config)
    assert not torch.equal(other.background, first.background)


def test_masked_pixels_do_not_matter() -> None:
    scene, config = synthetic(), replace(QUICK, steps=12, background="black")
    mask = np.ones((40, 40), bool)
    mask[:, 31:] = False
    spoiled = {f.name: np.where(mask[..., None], f.rgb, 1.0 - f.rgb) for f in scene.frames}
    assert_equal(fit_rgb(altered(scene, rgb_mask=mask), config), fit_rgb(altered(scene, rgb=spoiled, rgb_mask=mask), config))
    assert not torch.equal(
        fit_rgb(scene, config).gaussians.sh, fit_rgb(altered(scene, rgb=spoiled), config).gaussians.sh
    )  # without the mask they do


@pytest.mark.parametrize("budget", [90, 150, 200])
def test_the_budget_is_never_exceeded(budget: int) -> None:
    seen = []
    config = replace(QUICK, steps=60, densify=replace(QUICK.densify, max_gaussians=budget, every=5))
    scene = synthetic()
    model = fit_rgb(scene, config, progress=lambda step, steps, text: seen.append(int(text.split()[0].replace(",", ""))))
    assert len(seen) == 60 and max(seen) <= budget
    assert max(seen) >= 0.98 * budget  # and it is used, from 150 points on
    assert len(model.gaussians) == seen[-1] and max(model.history["gaussians"]) <= budget


def test_exposure_is_recovered_and_not_used_for_held_out_frames() -> None:
    scene = synthetic()
    gains = {f.name: 0.8 if k % 2 else 1.1 for k, f in enumerate(scene.train_frames)}
    gained = altered(scene, rgb={f.name: f.rgb * np.float32(gains[f.name]) for f in scene.train_frames})
    steps = 250
    config = replace(QUICK, steps=steps, exposure=True)
    training = Training(gained, config)
    while training.step < steps:
        training.advance()
    # Gains and offsets share the work, and there are no more of them than training frames: so look at what they do to mid grey.
    fitted = (0.4 * training.frame_optimizer.parameters["gain"] + training.frame_optimizer.parameters["offset"]).detach().mean(1)
    assert training.frame_optimizer.parameters["gain"].shape == (len(scene.train_frames), 3)
    bright = torch.tensor([gains[f.name] > 1 for f in scene.train_frames])
    ratio = (fitted[~bright].mean() / fitted[bright].mean()).item()
    assert fitted[~bright].max() < fitted[bright].min()
    assert ratio == pytest.approx(0.8 / 1.1, abs=0.1)
    model = training.model()
    frame = gained.held_out_frames[0]
    pose = gained.rgb_from_world(frame.name)
    plain = render(training.gaussians(), CAMERA, pose, settings=model.settings).over(model.background).detach().clamp(0, 1)
    np.testing.assert_array_equal(model.render(CAMERA, pose), plain.numpy())
    off = Training(gained, replace(config, exposure=False))
    for _ in range(5):
        off.advance()
    assert (off.frame_optimizer.parameters["gain"] == 1).all() and (off.frame_optimizer.parameters["offset"] == 0).all()


@pytest.mark.parametrize(("background", "expected"), [("black", 0.0), ("white", 1.0)])
def test_a_fixed_background_stays(background: Literal["black", "white"], expected: float) -> None:
    model = fit_rgb(synthetic(), replace(QUICK, steps=5, background=background))
    assert torch.equal(model.background, torch.full((3,), expected))


def test_bands_join_in_turn_over_the_first_half() -> None:
    training = Training(synthetic(), replace(QUICK, steps=24, sh_degree=2))
    bands = []
    while training.step < 24:
        training.advance()
        bands.append(training.gaussians().sh_degree)
        assert training.model().gaussians.sh.shape[1:] == (9, 3)  # a model is always whole
    assert bands == [0] * 4 + [1] * 4 + [2] * 16
    assert training.gaussians().sh[:, 4:].detach().abs().max() > 0


# --- checkpoints -----------------------------------------------------------------------------------


@pytest.mark.parametrize("at", [7, 53])
def test_an_interrupted_run_continues_bit_for_bit(tmp_path: Path, at: int) -> None:
    scene, config, path = synthetic(), replace(QUICK, steps=80), tmp_path / "rgb.pt"
    whole = fit_rgb(scene, config)

    def interrupt(step: int, steps: int, text: str) -> None:
        if step == at:
            raise Interrupted

    with pytest.raises(Interrupted):
        fit_rgb(scene, config, checkpoint=path, progress=interrupt)
    assert [p.name for p in tmp_path.iterdir()] == ["rgb.pt"]
    steps: list[int] = []
    resumed = fit_rgb(scene, config, checkpoint=path, progress=lambda step, *_: steps.append(step))
    assert 1 < steps[0] <= at + 1 and steps[-1] == 80  # it did not start over
    assert_equal(whole, resumed)
    assert whole.history == resumed.history


def test_a_checkpoint_of_other_settings_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rgb.pt"
    fit_rgb(synthetic(), replace(QUICK, steps=3), checkpoint=path)
    with pytest.raises(RtgsError, match="other training settings"):
        fit_rgb(synthetic(), replace(QUICK, steps=3, seed=1), checkpoint=path)


def test_a_damaged_checkpoint_is_named(tmp_path: Path) -> None:
    path = tmp_path / "rgb.checkpoint"
    path.write_bytes(b"half of it")  # as a power cut leaves it
    with pytest.raises(RtgsError, match=r"rgb\.checkpoint.*damaged.*remove it"):
        fit_rgb(synthetic(), QUICK, checkpoint=path)


def test_nothing_to_train_on_is_said() -> None:
    scene = synthetic()
    alone = scene_of(RIG, {"000": scene.world_from_rgb["000"]}, rgb=[scene.frames[0].rgb], points=scene.points)
    with pytest.raises(RtgsError, match="no training frame"):
        fit_rgb(alone, QUICK)
    # Without an extent the near plane and the position rate are zero, and every Gaussian is larger than the scene.
    turning = replace(scene, world_from_rgb={k: SE3(p.rotation, np.ones(3)) for k, p in scene.world_from_rgb.items()})
    with pytest.raises(RtgsError, match="one point"):
        fit_rgb(turning, QUICK)
