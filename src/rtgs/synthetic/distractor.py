"""A warm thing that stands in a few thermal images and is no part of the scene: a person, a reflection."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rtgs.config import SynthConfig
from rtgs.records.camera import Camera
from rtgs.records.capture import Split
from rtgs.synthetic.draws import rng as draws_of

ONE_FRAME_IN = 10
EXCESS_C = 15.0
_WIDTH, _HEIGHT = (0.05, 0.09), (0.10, 0.18)  # semi-axes, as shares of the image's width


@dataclass(frozen=True)
class Distractor:
    """An ellipse in one thermal image.

    Attributes:
        centre_px, semi_axes_px: in thermal pixels.
        angle_rad: by which the ellipse is turned.
        excess_c: what it adds to the temperatures behind it.
    """

    centre_px: tuple[float, float]
    semi_axes_px: tuple[float, float]
    angle_rad: float
    excess_c: float

    def excess(self, camera: Camera) -> NDArray[np.float32]:
        """`[H, W]` °C; the edge is about a pixel wide."""
        y, x = np.mgrid[: camera.height, : camera.width] + 0.5
        dx, dy = x - self.centre_px[0], y - self.centre_px[1]
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        radius = np.hypot((c * dx + s * dy) / self.semi_axes_px[0], (c * dy - s * dx) / self.semi_axes_px[1])
        inside = np.clip(0.5 + (1 - radius) * min(self.semi_axes_px), 0, 1)
        return (self.excess_c * inside).astype(np.float32)


def draw_distractors(config: SynthConfig, camera: Camera, names: Sequence[str]) -> dict[str, Distractor]:
    """A distractor for one training frame of every ten frames, by the frame's name.

    Held-out frames have none, so that their photographs show the scene.
    """
    rng, held_out = draws_of(config, "distractor"), Split().held_out_names(names)
    found = {}
    for first in range(0, len(names), ONE_FRAME_IN):
        training = [name for name in names[first : first + ONE_FRAME_IN] if name not in held_out]
        name = training[rng.integers(len(training))] if training else None
        centre, semi_axes = rng.uniform(0.2, 0.8, 2), (rng.uniform(*_WIDTH), rng.uniform(*_HEIGHT))
        angle = rng.normal(0, 0.2)
        if name is not None:
            found[name] = Distractor(
                (float(centre[0] * camera.width), float(centre[1] * camera.height)),
                (float(semi_axes[0] * camera.width), float(semi_axes[1] * camera.width)),
                float(angle),
                EXCESS_C,
            )
    return found
