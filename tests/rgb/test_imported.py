"""A trained model from a PLY file: its background, and whether it shows what the photographs show."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from tests.helpers.gaussian_clouds import cloud
from tests.helpers.scale_scenes import assembled, bumpy_ball, orbit, photographs

from rtgs.base.errors import RtgsError
from rtgs.config import RgbConfig
from rtgs.io.ply import write_ply
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.models import RgbModel
from rtgs.records.gaussians import Gaussians
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings
from rtgs.rgb.imported import import_model, model_from_ply
from rtgs.rgb.settings import NEAR_FRACTION

BEHIND = (0.9, 0.35, 0.2)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A bumpy ball before a coloured background, photographed with some noise."""
    model = RgbModel(bumpy_ball(), torch.tensor(BEHIND), RenderSettings(near_plane=0.05))
    bare = assembled(orbit(9), [np.zeros((44, 56), np.float32)] * 9)
    return assembled(orbit(9), [np.zeros((44, 56), np.float32)] * 9, rgb=photographs(bare, model))


def written(path: Path, gaussians: Gaussians, background: tuple[float, ...] | None = None) -> Path:
    write_ply(path / "model.ply", gaussians, background=background)
    return path / "model.ply"


def moved(gaussians: Gaussians, turn: SE3, factor: float = 1.0) -> Gaussians:
    """Positions turned, shifted and scaled about the origin. The Gaussians of the ball are round and their colours without direction."""
    means = torch.tensor(turn.apply(gaussians.means.double().numpy()), dtype=torch.float32)
    return replace(gaussians, means=means).scaled(factor)


def turned(degrees: float) -> SE3:
    axis = np.array([0.3, -0.5, 0.8]) / math.sqrt(0.98)
    return SE3(rotation_from_axis_angle(math.radians(degrees) * axis), np.zeros(3))


def test_a_ply_file_becomes_a_model_over_black(tmp_path: Path) -> None:
    gaussians = cloud(20, 2, 3)
    write_ply(tmp_path / "model.ply", gaussians)
    model = model_from_ply(tmp_path / "model.ply", 3.0, "reference", antialiased=True)
    assert not model.background.any() and torch.equal(model.gaussians.means, gaussians.means)
    assert model.settings.near_plane == 3.0 * NEAR_FRACTION and model.settings.backend == "reference"
    assert model.settings.antialiased


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_back_end_that_cannot_run_is_refused_before_the_file_is_read(tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match=r"no GPU.*\"cpu\""):
        model_from_ply(tmp_path / "none.ply", 1.0, "cuda")


def test_the_background_is_fitted_to_the_photographs(scene: Scene, tmp_path: Path) -> None:
    model, likeness = import_model(written(tmp_path, bumpy_ball()), scene, RgbConfig())
    assert model.background.tolist() == pytest.approx(BEHIND, abs=0.01)
    assert likeness.explained > 0.7 and likeness.psnr > 30
    (decision,) = model.decisions
    assert decision.name == "background" and "least squares over 6 training photographs" in decision.reason
    assert decision.error_before is not None and decision.error_after is not None
    assert decision.error_before > 5 * decision.error_after and decision.error_after < 3.0
    assert tuple(int(decision.choice[i : i + 2], 16) for i in (1, 3, 5)) == pytest.approx([255 * v for v in BEHIND], abs=3)


@pytest.mark.parametrize(("background", "color"), [("white", 1.0), ("black", 0.0)])
def test_a_background_that_the_user_names_is_obeyed(scene: Scene, tmp_path: Path, background: str, color: float) -> None:
    path = written(tmp_path, bumpy_ball(), (0.5, 0.5, 0.5))
    model, _ = import_model(path, scene, RgbConfig(background=background, antialiased=True))  # type: ignore[arg-type]
    assert model.background.tolist() == [color] * 3 and model.settings.antialiased
    assert "set by rgb.background" in model.decisions[0].reason


def test_a_background_that_the_file_states_is_taken(scene: Scene, tmp_path: Path) -> None:
    stated = tuple(torch.tensor([0.8, 0.3, 0.123]).tolist())  # float32, as a model has it
    model, _ = import_model(written(tmp_path, bumpy_ball(), stated), scene, RgbConfig())
    assert tuple(model.background.tolist()) == stated and "stated in the file" in model.decisions[0].reason


WRONG = {
    "turned by 10°": (turned(10), 1.0),
    "turned by 90°": (turned(90), 1.0),
    "upside down": (turned(180), 1.0),
    "half as large": (turned(0), 0.5),
    "smaller by a tenth": (turned(0), 0.9),
    "larger by a tenth": (turned(0), 1.1),
    "twice as large": (turned(0), 2.0),
    "shifted": (SE3(np.eye(3), np.array([0.2, -0.1, 0.1])), 1.0),
    "out of view": (SE3(np.eye(3), np.array([0.0, 0.0, 900.0])), 1.0),
    "mirrored": (SE3(np.diag([-1.0, 1.0, 1.0]), np.zeros(3)), 1.0),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_model_in_another_frame_or_unit_is_refused(scene: Scene, tmp_path: Path, case: str) -> None:
    path = written(tmp_path, moved(bumpy_ball(), *WRONG[case]))
    with pytest.raises(RtgsError, match=r"model\.ply: does not show .* % of the detail of 6 .*frame and the unit of the capture"):
        import_model(path, scene, RgbConfig())


def test_a_model_of_another_scene_is_refused(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match="does not show what the photographs show"):
        import_model(written(tmp_path, cloud(400, 1, 3)), scene, RgbConfig())


def test_a_poor_model_of_the_scene_is_accepted(scene: Scene, tmp_path: Path) -> None:
    g = torch.Generator().manual_seed(1)
    ball = bumpy_ball()
    poor = replace(ball, means=ball.means + 0.03 * torch.randn(ball.means.shape, generator=g))
    _, likeness = import_model(written(tmp_path, poor), scene, RgbConfig())
    assert 0.0 < likeness.explained < 0.6
