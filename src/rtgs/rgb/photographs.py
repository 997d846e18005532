"""A model beside a few training photographs: which background suits it, and whether it shows the same scene."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.models import RgbModel
from rtgs.records.scene import Scene
from rtgs.renderer import render

_MOST = 6  # photographs
_SIDE = 320  # pixels of the longer side, at which they are compared
_DETAIL = 16  # detail is what is smaller than this part of the longer side

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Likeness:
    """How like the photographs a model's pictures are.

    Attributes:
        rms: root mean square of the difference, of white. psnr: the same in dB.
        explained: share of the photographs' detail that the pictures explain: 1 − Σ (d_I − d_R)² / Σ d_I², where detail d is a picture
            minus its mean in a window around each pixel. It is 1 for equal pictures and 0 for pictures without any detail. It is below
            0 where the detail of both is unrelated, because both then add up in the difference.
    """

    rms: float
    explained: float

    @property
    def psnr(self) -> float:
        return math.inf if self.rms == 0 else -20 * math.log10(self.rms)


@dataclass(frozen=True, eq=False)
class Views:
    """Some training photographs at a reduced size, and what a model shows there.

    Attributes:
        photographs: `[V, h, w, 3]`. colors: `[V, h, w, 3]`, rendered over black. clear: `[V, h, w, 1]`, the background's share.
        valid: `[h, w, 1]`, 1 where the camera has a pixel, else 0.
    """

    photographs: Floats
    colors: Floats
    clear: Floats
    valid: Floats

    @staticmethod
    def of(scene: Scene, model: RgbModel) -> Views:
        """Render the model at a few training frames, evenly spaced."""
        frames = scene.train_frames or scene.frames
        chosen = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, min(_MOST, len(frames))).round().astype(int))]
        camera = scene.rig.rgb
        share = min(1.0, _SIDE / max(camera.width, camera.height))
        camera = camera.resized(max(1, round(camera.width * share)), max(1, round(camera.height * share)))
        size = (camera.width, camera.height)
        photographs, colors, clear = [], [], []
        for frame in chosen:
            with torch.no_grad():
                view = render(model.gaussians, camera, scene.rgb_from_world(frame.name), settings=model.settings)
            photographs.append(cv2.resize(frame.rgb, size, interpolation=cv2.INTER_AREA))
            colors.append(view.color.numpy())
            clear.append(1.0 - view.alpha.numpy()[..., None])
        valid = cv2.resize(scene.capture.rgb_mask.astype(np.float64), size, interpolation=cv2.INTER_AREA) > 0.999
        whole, over_black, share_clear = (np.stack(images).astype(np.float64) for images in (photographs, colors, clear))
        return Views(whole, over_black, share_clear, valid[..., None].astype(np.float64))

    @property
    def count(self) -> int:
        """How many photographs there are."""
        return len(self.photographs)

    def best_background(self) -> Tensor:
        """`[3]`: the colour in [0, 1] with the least squared error; black where no background shows."""
        seen = self.clear * self.valid
        total = float((seen * self.clear).sum())
        if total == 0.0:
            return torch.zeros(3)
        color = (seen * (self.photographs - self.colors)).sum(axis=(0, 1, 2)) / total
        return torch.tensor(color.clip(0.0, 1.0), dtype=torch.float32)

    def likeness(self, background: Tensor) -> Likeness:
        """How like the photographs the model is over a background `[3]`."""
        shown = (self.colors + self.clear * background.double().numpy()).clip(0.0, 1.0)
        missed = difference = detail = 0.0
        for photograph, picture in zip(self.photographs, shown, strict=True):
            here, there = self._detail(photograph), self._detail(picture)
            missed += float(((here - there) ** 2).sum())
            detail += float((here**2).sum())
            difference += float((self.valid * (photograph - picture) ** 2).sum())
        rms = math.sqrt(difference / max(3.0 * self.count * float(self.valid.sum()), 1.0))
        return Likeness(rms, 1.0 - missed / detail if detail > 0 else 0.0)

    def _detail(self, picture: Floats) -> Floats:
        """A picture `[h, w, 3]` minus the mean of the valid pixels in a window around each pixel; 0 where the camera has none."""
        width = 2 * max(1, round(max(picture.shape[:2]) / _DETAIL / 2)) + 1

        def sums(values: Floats) -> Floats:
            found = cv2.boxFilter(values, -1, (width, width), normalize=False, borderType=cv2.BORDER_CONSTANT)
            return np.asarray(found, np.float64).reshape(values.shape)

        mean: Floats = sums(picture * self.valid) / np.maximum(sums(self.valid), 1.0)
        detail: Floats = self.valid * (picture - mean)
        return detail
