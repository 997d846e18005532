"""Planar: no scale at all. Thermal images are warped onto the RGB views as if the scene were one plane before the camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.experiments.strategies.strategy import Given, Placement, Strategy
from rtgs.maths.geometry import SE3
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene

LEAST_SHARE = 0.5  # of the thermal image that has to come back: every row is scored there, and half an image is no capture


def homography(rig: Rig, plane_m: float) -> NDArray[np.float64]:
    """`rgb_from_thermal` for pixels `[3, 3]`: H = K_rgb (R + t nᵀ / d) K_th⁻¹, the plane at `plane_m` = d along the optical axis n."""
    motion = rig.rgb_from_thermal
    plane = np.outer(motion.translation, [0.0, 0.0, 1.0]) / plane_m
    return rig.rgb.matrix @ (motion.rotation + plane) @ np.linalg.inv(rig.thermal.matrix)


def warp(
    image: NDArray[np.float32], valid: NDArray[np.bool_], source_from_target: NDArray[np.float64], size: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Resample `[H, W]` bilinearly to `size` = (h, w) by a homography of pixels (centres at half integers).

    Returns:
        The image and its valid pixels: those whose four neighbours in the source are valid.
    """
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    u, v, w = np.einsum("ij,jhw->ihw", source_from_target, np.stack([x, y, np.ones_like(x)]))
    ahead = w > 1e-9  # else behind the camera
    at_x, at_y = (np.where(ahead, a / np.where(ahead, w, 1.0), -2.0).clip(-2.0, 1e5) - 0.5 for a in (u, v))
    maps = at_x.astype(np.float32), at_y.astype(np.float32)
    known = np.where(valid, image, 0.0).astype(np.float32)
    share = cv2.remap(valid.astype(np.float32), *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
    return np.asarray(cv2.remap(known, *maps, cv2.INTER_LINEAR), np.float32), share > 1 - 1e-4


@dataclass(frozen=True, eq=False)
class PlanarScene:
    """A capture whose thermal images have been warped onto the RGB views.

    Attributes:
        scene: its thermal camera is the RGB camera, with no baseline, so that the scale means nothing.
        thermal_valid: `[h, w]`, pixels of the true thermal camera that a render can be brought back to.
    """

    scene: Scene
    rgb_from_thermal: NDArray[np.float64]
    thermal_valid: NDArray[np.bool_]

    @staticmethod
    def of(scene: Scene, plane_m: float) -> PlanarScene:
        """The capture warped by way of a plane at `plane_m` metres from the thermal camera, square to its axis.

        Raises:
            RtgsError: the plane brings less than half of the thermal image into the RGB view.
        """
        rig, capture = scene.rig, scene.capture
        there = homography(rig, plane_m)
        back = np.asarray(np.linalg.inv(there), np.float64)
        size = rig.rgb.height, rig.rgb.width
        frames = []
        mask = np.zeros(size, bool)
        for frame in capture.frames:
            thermal, mask = warp(frame.thermal, capture.thermal_mask, back, size)
            frames.append(frame.with_thermal(thermal))
        _, valid = warp(np.zeros(size, np.float32), mask, there, (rig.thermal.height, rig.thermal.width))
        valid &= capture.thermal_mask
        share = valid.sum() / capture.thermal_mask.sum()
        if share < LEAST_SHARE:
            raise RtgsError(
                f"has too little to be scored on: a plane at {plane_m:g} m (baselines away: {plane_m / rig.baseline_m:.3g}) brings only "
                f"{share:.0%} of the thermal image into the RGB view; --plane-m puts it elsewhere"
            )
        own = Rig(rig.rgb, rig.rgb, SE3.identity())
        warped = replace(capture, raw_rig=own, rig=own, frames=tuple(frames), thermal_mask=mask)
        return PlanarScene(replace(scene, capture=warped), there, valid)

    def warped_back(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """A render at the RGB pose in the thermal camera's pixels, NaN where there is none."""
        thermal, _ = warp(image, np.ones(image.shape, bool), self.rgb_from_thermal, self.thermal_valid.shape)
        return np.where(self.thermal_valid, thermal, np.float32(np.nan))


def _place(given: Given, progress: Progress) -> Placement:
    warped = PlanarScene.of(given.scene, given.config.plane_m)
    return Placement(warped.scene, None, warped.warped_back)


PLANAR = Strategy("planar", "Planar", _place, lambda given: given.config.plane_m)
