"""Where the scale can lie at all: a bracket from image flow, without a guess."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.errors import RtgsError
from rtgs.gaussians import Gaussians
from rtgs.render import RenderSettings, render
from rtgs.scene import Scene

_FRAMES = 12  # enough for a percentile
_WIDTH = 160


def flow_per_unit(scene: Scene, gaussians: Gaussians, settings: RenderSettings) -> NDArray[np.float64]:
    """‖∂(u, v)/∂s‖ at s → 0 in thermal pixels per unit of `sfm_per_metre`, one value a covered pixel, over training frames.

    At s = 0 the thermal camera stands in the RGB camera's centre. A thermal camera-frame point moves by −Rᵀt per unit of s, so
    the flow of a point at depth z falls as 1/z: a forward baseline flows too, a far wall hardly.

    Raises:
        RtgsError: the model covers no pixel of any view.
    """
    rig, frames = scene.rig, scene.train_frames
    camera = rig.thermal
    small = camera.resized(min(_WIDTH, camera.width), max(1, round(camera.height * min(_WIDTH, camera.width) / camera.width)))
    velocity = -(rig.rgb_from_thermal.rotation.T @ rig.rgb_from_thermal.translation)
    slope_x = ((np.arange(small.width) + 0.5 - small.cx) / small.fl_x)[None, :]
    slope_y = ((np.arange(small.height) + 0.5 - small.cy) / small.fl_y)[:, None]
    rate = np.hypot(camera.fl_x * (velocity[0] - slope_x * velocity[2]), camera.fl_y * (velocity[1] - slope_y * velocity[2]))
    flows = []
    for frame in frames[:: max(1, len(frames) // _FRAMES)]:
        with torch.no_grad():
            view = render(
                gaussians, small, scene.thermal_from_world(frame.name, 0.0), settings=replace(settings, with_depth=True)
            )
        assert view.depth is not None
        covered = (view.alpha > 0.5).numpy()
        depth = (view.depth / view.alpha.clamp_min(1e-6)).numpy().astype(np.float64)
        flows.append((rate / np.maximum(depth, 1e-12))[covered])
    flow = np.concatenate(flows)
    if not len(flow):
        raise RtgsError("scale: the RGB model covers no pixel of any thermal view; check the rig's rotation and the poses.")
    return flow


def bracket(flow: NDArray[np.float64], width: int) -> tuple[float, float]:
    """(lo, hi) of `sfm_per_metre`: the 90th percentile of the flow is half a pixel at `lo` and half the image at `hi`.

    Raises:
        RtgsError: nothing flows.
    """
    fast = float(np.percentile(flow, 90))
    if not fast > 0:
        raise RtgsError("scale: the picture does not change with the scale; the rig's baseline is zero.")
    return 0.5 / fast, 0.5 * width / fast
