"""Which gradients are edges: ε of Eq. 5 from the pictures, and what the thermal sensor draws into every one of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from torch import Tensor

from rtgs.image import GRAY_WEIGHTS, SOBEL, downsample, downsample_mask, erode_for_sobel, sobel, to_gray
from rtgs.models import RgbModel
from rtgs.render import render
from rtgs.scene import Frame, Scene

_FEWEST_FRAMES = 8
_AGREEMENT = 0.7  # correlation of the two halves
_SMOOTH_PX = 3.0
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


def sensor_pattern(images: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """`[h, w]`: what stays in the same place of all thermal images `[F, h, w]` and has the shape of a sensor's error.

    Of the median over frames: a quadratic surface (vignetting, the housing's own warmth) and the fine part of row and column levels
    (readout noise), these only where two halves of the frames agree about them. The median as it is would hold the scene wherever that
    stays put in the picture, as in an orbit; a row's median over its pixels, taken against its neighbours', does not.
    """
    if len(images) < _FEWEST_FRAMES or mask.sum() < 100:
        return np.zeros(mask.shape, np.float32)
    middle = np.median(images, axis=0).astype(np.float64)
    surface = _quadratic(middle, mask)
    halves = [np.median(images[k::2], axis=0) - surface for k in (0, 1)]
    pattern = surface - surface[mask].mean()
    for axis in (0, 1):
        levels = _fine_levels(middle - surface, mask, axis)
        first, second = (_fine_levels(half, mask, axis) for half in halves)
        size = math.sqrt(float(first @ first) * float(second @ second))
        if size > 0 and float(first @ second) / size > _AGREEMENT:
            pattern = pattern + np.expand_dims(levels, 1 - axis)
    return np.where(mask, pattern, 0.0).astype(np.float32)


def _quadratic(image: NDArray[np.float64], mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    y, x = (np.linspace(-1.0, 1.0, n) for n in image.shape)
    terms = np.stack(
        np.broadcast_arrays(1.0 + 0 * y[:, None], x[None], y[:, None], x[None] ** 2, y[:, None] ** 2, y[:, None] * x[None])
    )
    weights, *_ = np.linalg.lstsq(terms[:, mask].T, image[mask], rcond=None)
    return np.asarray(np.tensordot(weights, terms, axes=1))


def _fine_levels(image: NDArray[np.float64], mask: NDArray[np.bool_], axis: int) -> NDArray[np.float64]:
    """Median of each row (`axis` 0) or column (1) of the image less its own smooth course along that axis."""
    filled = np.where(mask, image, np.median(image[mask]))
    fine = np.where(mask, filled - gaussian_filter1d(filled, _SMOOTH_PX, axis=axis), np.nan)
    seen = np.asarray(mask.any(axis=1 - axis))
    levels = np.zeros(len(seen))
    levels[seen] = np.nanmedian(np.compress(seen, fine, axis=axis), axis=1 - axis)
    return levels


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
