"""Photographs as the training loss takes them: at full size or reduced, with the pixels that count."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor

from rtgs.losses.photometric import Target
from rtgs.losses.ssim import whole_windows
from rtgs.records.scene import Frame, Scene


class TrainingImages:
    """Targets of a scene's frames. Reduced images of one level are kept at a time: training goes through the levels once."""

    def __init__(self, scene: Scene) -> None:
        self._mask = scene.capture.rgb_mask
        self._reduced: dict[str, Tensor] = {}
        self._factor = 1  # of those
        self._masks: dict[int, tuple[Tensor | None, Tensor | None]] = {}

    def target(self, frame: Frame, factor: int) -> Target:
        """The frame's photograph, reduced `factor` times, and what of it counts."""
        return Target(self._image(frame, factor), *self._pixels_and_windows(factor))

    def _image(self, frame: Frame, factor: int) -> Tensor:
        if factor == 1:
            return torch.from_numpy(frame.rgb)
        if factor != self._factor:
            self._reduced.clear()
            self._factor = factor
        if frame.name not in self._reduced:
            image = frame.rgb
            height, width = image.shape[:2]
            small = cv2.resize(image, (width // factor, height // factor), interpolation=cv2.INTER_AREA)
            self._reduced[frame.name] = torch.from_numpy(small)
        return self._reduced[frame.name]

    def _pixels_and_windows(self, factor: int) -> tuple[Tensor | None, Tensor | None]:
        """Valid pixels and the centres of SSIM windows that see nothing else, `[H, W]` bool each; None where all are valid."""
        if factor not in self._masks:
            mask = self._mask
            if factor > 1:
                size = (mask.shape[1] // factor, mask.shape[0] // factor)
                mask = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.999
            pixels = torch.from_numpy(np.ascontiguousarray(mask))
            self._masks[factor] = (None, None) if mask.all() else (pixels, whole_windows(pixels))
        return self._masks[factor]
