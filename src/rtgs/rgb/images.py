"""Photographs as the training loss takes them: at full size or reduced, with the pixels that count."""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.base.memory import Memory
from rtgs.images.cache import ImageCache
from rtgs.losses.photometric import Target
from rtgs.losses.ssim import whole_windows
from rtgs.records.scene import Frame, Scene


class TrainingImages:
    """Targets of a scene's frames. Reduced images of one level are kept at a time: training goes through the levels once.

    Args:
        most_bytes: memory for reduced images; None: what `Memory.of()` gives them. Those that do not fit are made again.
    """

    def __init__(self, scene: Scene, most_bytes: int | None = None) -> None:
        self._mask = scene.capture.rgb_mask
        self._most_bytes = Memory.of().reduced if most_bytes is None else most_bytes
        self._reduced, self._factor = ImageCache(self._most_bytes), 1  # images of this factor
        self._masks: dict[int, tuple[Tensor | None, Tensor | None]] = {}

    def target(self, frame: Frame, factor: int) -> Target:
        """The frame's photograph, reduced `factor` times, and what of it counts."""
        return Target(self._image(frame, factor), *self._pixels_and_windows(factor))

    def _image(self, frame: Frame, factor: int) -> Tensor:
        if factor == 1:
            return torch.from_numpy(frame.rgb)
        if factor != self._factor:
            self._reduced, self._factor = ImageCache(self._most_bytes), factor

        def make() -> NDArray[np.float32]:
            image = frame.rgb
            height, width = image.shape[:2]
            return np.asarray(cv2.resize(image, (width // factor, height // factor), interpolation=cv2.INTER_AREA), np.float32)

        return torch.from_numpy(self._reduced.get(frame.name, make))

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
