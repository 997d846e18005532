"""Thermal images as the global search compares them: without the sensor's pattern, in [0, 1], with the ε that suits them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.images.patterns import sensor_pattern
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.models import RgbModel
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.renderer import render
from rtgs.scale.comparison import Comparison
from rtgs.scale.edge_epsilon import mean_gradients, model_error
from rtgs.scale.objective import Objective, scaled_thermal
from rtgs.scale.problem import Problem

_COARSE_SIDE = 64  # pixels of the shorter side in the scan: the picture is halved while it keeps this many
EPSILON_FRAMES = 6  # from which ε of the renders is measured

T = TypeVar("T")


@dataclass(frozen=True, eq=False, kw_only=True)
class Pictures:
    """Thermal images in [0, 1] and how renders are compared with them, from which objectives of any size are made.

    Attributes:
        scene, model, frames: what is rendered.
        thermal: frame name → `[h, w]`.
        level_weights: of Eq. 7 at full size.
        epsilon, render_epsilon: one a level, from the full size to the second level of the smallest one.
        masks: frame name → pixels that count; None: all valid ones.
        blur_px: standard deviation of the Gaussian that renders are blurred by, in pixels of the full size.
        renders: how many pictures were rendered to measure ε.
    """

    scene: Scene
    model: RgbModel
    frames: tuple[Frame, ...]
    thermal: dict[str, NDArray[np.float32]]
    level_weights: tuple[float, ...]
    epsilon: tuple[float, ...]
    render_epsilon: tuple[float, ...]
    comparison: Comparison
    masks: dict[str, NDArray[np.bool_]] | None = None
    blur_px: float = 0.0
    renders: int = 0
    _objectives: dict[int, Objective] = field(init=False, repr=False, default_factory=dict)  # filled by `objective` alone

    @staticmethod
    def of(problem: Problem) -> Pictures:
        """Remove the sensor's pattern, and measure ε where `ScaleConfig.epsilon` gives none.

        It is `Comparison.edge` mean gradients: of the thermal images for them, of the model's errors against RGB images for renders.
        """
        scene, model, frames, comparison = problem.scene, problem.model, problem.frames, problem.comparison
        valid = scene.capture.thermal_mask
        images = {f.name: f.thermal for f in frames}
        if comparison.without_pattern:
            pattern = sensor_pattern(np.stack(list(images.values())), valid)
            images = {name: image - pattern for name, image in images.items()}
        thermal = scaled_thermal(images, valid)
        masks = {f.name: _covered(scene, model, f) for f in frames} if comparison.covered else None
        weights, given = problem.config.level_weights, problem.config.epsilon
        levels = max(len(weights), halvings(scene) + 2)  # two at the smallest size
        measured = 0
        if given is not None:
            own = other = (given,) * levels
        else:
            own = mean_gradients([torch.from_numpy(image) for image in thermal.values()], valid, levels, comparison.across)
            errors = []
            for frame in some_of(frames, EPSILON_FRAMES):
                errors.append(model_error(scene, model, frame))
                problem.progress("noise")
            everywhere = np.ones(errors[0].shape, dtype=bool)
            other = mean_gradients(errors, everywhere, levels, comparison.across)
            own, other = (tuple(comparison.edge * e for e in gradients) for gradients in (own, other))
            measured = len(errors)
        return Pictures(
            scene=scene,
            model=model,
            frames=frames,
            thermal=thermal,
            level_weights=weights,
            epsilon=own,
            render_epsilon=other,
            comparison=comparison,
            masks=masks,
            renders=measured,
        )

    def edge_loss(self, halved: int = 0) -> EdgeLoss:
        """How pictures halved so many times are compared: with the level weights at full size, and with two equal levels below."""
        weights = self.level_weights if halved == 0 else (1.0, 1.0)
        levels = slice(halved, halved + len(weights))
        return EdgeLoss(
            weights,
            epsilon=self.epsilon[levels],
            render_epsilon=self.render_epsilon[levels],
            per_edge=self.comparison.per_edge,
            across=self.comparison.across,
            blur_px=self.blur_px / 2**halved,
        )

    def objective(self, halved: int = 0) -> Objective:
        """The loss of pictures halved so many times. The same object for the same size, so that its targets are prepared once."""
        if halved not in self._objectives:
            self._objectives[halved] = Objective(
                self.scene,
                self.model,
                self.frames,
                self.edge_loss(halved),
                reduction=2**halved,
                thermal=self.thermal,
                masks=self.masks,
            )
        return self._objectives[halved]


def halvings(scene: Scene) -> int:
    """How often the thermal picture can be halved for the scan."""
    side = min(scene.rig.thermal.width, scene.rig.thermal.height)
    return max(0, int(math.log2(side / _COARSE_SIDE))) if side >= _COARSE_SIDE else 0


def some_of(frames: Sequence[T], most: int) -> Sequence[T]:
    """At most so many of the frames (or of their indices), evenly spaced."""
    return frames[:: -(-len(frames) // most)]


def _covered(scene: Scene, model: RgbModel, frame: Frame) -> NDArray[np.bool_]:
    """`[h, w]`: half opaque or more, with nearly no baseline. A mask that followed s would reward leaving the scene."""
    with torch.no_grad():
        view = render(model.gaussians, scene.rig.thermal, scene.thermal_from_world(frame.name, 1e-9), settings=model.settings)
    return np.asarray(view.alpha.numpy() >= 0.5)
