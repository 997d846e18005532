"""A small scene for training: a coloured ball, seen from around it."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import torch
from tests.helpers.scene_record import scene_of
from torch import Tensor

from rtgs.config import DensifyConfig, RgbConfig
from rtgs.maths.geometry import SE3, look_at
from rtgs.maths.sh import C0
from rtgs.metrics.basic import psnr
from rtgs.models import RgbModel
from rtgs.records.camera import Camera
from rtgs.records.capture import SparsePoints
from rtgs.records.gaussians import Gaussians
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings, render

CAMERA = Camera("PINHOLE", 40, 40, 44.0, 44.0, 20.0, 20.0)
RIG = Rig(CAMERA, CAMERA, SE3(np.eye(3), np.array([0.1, 0.0, 0.0])))
QUICK = RgbConfig(
    steps=120, sh_degree=1, coarse_to_fine=(), densify=DensifyConfig(max_gaussians=300, every=20, start=0.05, stop=0.6)
)


@lru_cache(maxsize=1)
def synthetic() -> Scene:
    """Ten views of a coloured ball before a grey background; 150 of its 400 centres, displaced, are the sparse points."""
    g = torch.Generator().manual_seed(0)
    n = 400
    directions = torch.nn.functional.normalize(torch.randn(n, 3, generator=g), dim=1)
    # Colours vary slowly over the ball, so that 40 pixels can show them.
    colors = 0.5 + 0.4 * torch.sin(3.0 * directions @ torch.randn(3, 3, generator=g))
    truth = Gaussians(
        directions * (0.9 + 0.1 * torch.rand(n, 1, generator=g)),
        torch.randn(n, 4, generator=g),
        math.log(0.1) + 0.2 * torch.randn(n, 3, generator=g),
        torch.full((n,), 3.0),
        ((colors - 0.5) / C0)[:, None],
    )
    poses, images = [], []
    for k in range(10):
        pose = look_at([3 * math.cos(0.63 * k), 3 * math.sin(0.63 * k), 0.8 * math.sin(1.7 * k)], [0, 0, 0])
        view = render(truth, CAMERA, pose.inverse(), settings=RenderSettings()).over(torch.tensor([0.3, 0.35, 0.4]))
        poses.append(pose)
        images.append(view.numpy().clip(0, 1))
    points = truth.means[:150] + 0.02 * torch.randn(150, 3, generator=g)
    return scene_of(RIG, poses, rgb=images, points=SparsePoints(points.double().numpy(), colors[:150].numpy()))


def held_out_psnr(scene: Scene, model: RgbModel) -> float:
    return float(np.mean([psnr(model.render(CAMERA, scene.rgb_from_world(f.name)), f.rgb) for f in scene.held_out_frames]))


def tensors(model: RgbModel) -> dict[str, Tensor]:
    return {**model.gaussians.tensors(), "background": model.background}


def assert_equal(a: RgbModel, b: RgbModel) -> None:
    for name, tensor in tensors(a).items():
        assert torch.equal(tensor, tensors(b)[name]), name
