"""Where the scale can lie at all: a bracket from image flow, without a guess."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.models import RgbModel
from rtgs.records.camera import Camera
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.renderer import render

_FRAMES = 12  # enough for a percentile
_WIDTH = 160
LOWEST_PX = 0.5  # of flow, at the lower end


class Bracket(NamedTuple):
    """The scales that the images can tell apart, in `sfm_per_metre`.

    "Flow" is how far the picture has moved from where it is without a baseline: the 90th percentile over the pixels, in thermal pixels.
    It is half a pixel at `lower` and half the image's width at `upper`.
    """

    lower: float
    upper: float

    def flow_px(self, theta: float) -> float:
        """The flow at θ = ln `sfm_per_metre`."""
        return LOWEST_PX / self.lower * math.exp(theta)

    def pixel(self, theta: float, pixels: float = 1.0) -> float:
        """The change of θ that moves the picture by one pixel, or by so many."""
        return pixels * self.lower / LOWEST_PX / math.exp(theta)

    def __str__(self) -> str:
        return f"{self.lower:.4g} to {self.upper:.4g} SfM units per metre"


def find_bracket(scene: Scene, model: RgbModel) -> Bracket:
    """The bracket of a scene from the depths of its RGB model.

    Raises:
        RtgsError: the model covers no pixel of any view, or the rig's baseline is zero.
    """
    return bracket_of(flow_per_unit(scene, model), scene.rig.thermal.width)


def bracket_of(flow: NDArray[np.float64], width: int) -> Bracket:
    """The bracket for a flow per unit of `sfm_per_metre` (`flow_per_unit`) and an image width, both in pixels.

    Raises:
        RtgsError: nothing flows.
    """
    fast = float(np.percentile(flow, 90))
    if not fast > 0:
        raise RtgsError("scale: the picture does not change with the scale; the rig's baseline is zero.")
    return Bracket(LOWEST_PX / fast, 0.5 * width / fast)


def flow_per_unit(scene: Scene, model: RgbModel) -> NDArray[np.float64]:
    """‖∂(u, v)/∂s‖ at s → 0 in thermal pixels per unit of `sfm_per_metre`, one value a covered pixel, over training frames.

    At s = 0 the thermal camera stands in the RGB camera's centre. A point in the thermal camera's frame moves by −Rᵀt per unit of s, so
    the flow of a point at depth z falls as 1/z: a forward baseline flows too, a far wall hardly.

    Raises:
        RtgsError: the model covers no pixel of any view.
    """
    frames = scene.train_frames
    flows = []
    for frame in frames[:: max(1, len(frames) // _FRAMES)]:
        flow, covered = flow_field(scene, model, frame)
        flows.append(np.hypot(*flow)[covered])
    flow = np.concatenate(flows)
    if not len(flow):
        raise RtgsError("scale: the RGB model covers no pixel of any thermal view; check the rig's rotation and the poses.")
    return flow


def flow_field(scene: Scene, model: RgbModel, frame: Frame) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """∂(u, v)/∂s at s → 0 in thermal pixels, `[2, h, w]` at a reduced size, and which of its pixels the model covers."""
    camera, small = scene.rig.thermal, _small(scene)
    velocity = -scene.world_per_metre(1.0) * (scene.rig.rgb_from_thermal.rotation.T @ scene.rig.rgb_from_thermal.translation)
    slope_x = ((np.arange(small.width) + 0.5 - small.cx) / small.fl_x)[None, :]
    slope_y = ((np.arange(small.height) + 0.5 - small.cy) / small.fl_y)[:, None]
    pose, settings = scene.thermal_from_world(frame.name, 0.0), replace(model.settings, with_depth=True)
    with torch.no_grad():
        view = render(model.gaussians, small, pose, settings=settings)
    assert view.depth is not None
    depth = np.maximum((view.depth / view.alpha.clamp_min(1e-6)).numpy().astype(np.float64), 1e-12)
    along_x = camera.fl_x * (velocity[0] - slope_x * velocity[2]) / depth
    along_y = camera.fl_y * (velocity[1] - slope_y * velocity[2]) / depth
    return np.stack([along_x, along_y]), (view.alpha > 0.5).numpy()


def information(scene: Scene, model: RgbModel, frames: Sequence[Frame]) -> NDArray[np.float64]:
    """`[F]`: how much each frame can say about the scale, up to one factor: Σ (n · ∂(u, v)/∂s)² over covered pixels.

    n is the thermal image's gradient divided by its mean magnitude, cut at length 1. An edge along the flow says nothing, nor does a
    far one.
    """
    small, worth = _small(scene), []
    for frame in frames:
        flow, covered = flow_field(scene, model, frame)
        image = cv2.resize(frame.thermal, (small.width, small.height), interpolation=cv2.INTER_AREA)
        mask = scene.capture.thermal_mask.astype(np.float32)
        valid = cv2.resize(mask, (small.width, small.height), interpolation=cv2.INTER_AREA) > 0.999
        gradient = np.array(np.gradient(image.astype(np.float64)))[::-1]
        size = np.hypot(*gradient)
        unit = gradient / np.maximum(size, max(float(size[valid].mean()) if valid.any() else 0.0, 1e-12))
        worth.append(float(((unit * flow).sum(axis=0) ** 2)[covered & valid].sum()))
    return np.array(worth)


def _small(scene: Scene) -> Camera:
    camera = scene.rig.thermal
    width = min(_WIDTH, camera.width)
    return camera.resized(width, max(1, round(camera.height * width / camera.width)))
