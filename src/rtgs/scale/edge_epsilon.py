"""Which gradients are edges: ε of Eq. 5 from the pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.images.filters import GRAY_WEIGHTS, SOBEL, downsample, downsample_mask, erode_for_sobel, sobel, to_gray
from rtgs.models import RgbModel
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.renderer import render

_LEAST = 1e-6  # of a picture without any gradient: the paper's ε


def mean_gradients(
    images: Sequence[Tensor], mask: NDArray[np.bool_], levels: int, across: tuple[float, float] = SOBEL
) -> tuple[float, ...]:
    """Mean ‖∇I‖ at each pyramid level, over the valid pixels of all images `[H, W]`.

    As ε of the thermal images it weighs a gradient by how far it stands out of its picture, where the paper's 1e-6 gives a sensor's
    noise in a flat area the same unit vector as an edge.
    """
    valid = torch.from_numpy(np.ascontiguousarray(mask))
    found = []
    for level in range(levels):
        inner = erode_for_sobel(downsample_mask(valid, 2**level))
        values = torch.cat([torch.hypot(*sobel(downsample(image, 2**level), across))[inner] for image in images])
        found.append(max(float(values.double().mean()), _LEAST) if len(values) else _LEAST)
    return tuple(found)


def model_error(scene: Scene, model: RgbModel, frame: Frame) -> Tensor:
    """The model's gray picture minus the photograph, from the RGB camera at the thermal camera's pixels per degree: `[H, W]`.

    Its mean gradient measures the ε of renders: what is no edge of the scene should not count as one.
    """
    rig = scene.rig
    share = min(1.0, rig.thermal.fl_x / rig.rgb.fl_x)
    camera = rig.rgb.resized(max(3, round(rig.rgb.width * share)), max(3, round(rig.rgb.height * share)))
    settings = replace(model.settings, with_depth=False, channel_weights=GRAY_WEIGHTS)
    with torch.no_grad():
        view = render(model.gaussians, camera, scene.rgb_from_world(frame.name), settings=settings)
    gray = view.color[..., 0] + (1.0 - view.alpha) * to_gray(model.background)
    photo = cv2.resize(frame.rgb, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return (gray - to_gray(torch.from_numpy(photo)).to(gray.dtype)).float()
