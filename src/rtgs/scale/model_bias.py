"""What the RGB model itself does to a rig: where its edges lie beside those of the photographs that it was made from.

The descent for the rig is repeated with the photographs in place of the thermal images, seen from the RGB cameras. There the answer is
known: nothing moves. What moves nevertheless is the model's error, e.g. outlines that are drawn too wide and look like another focal
length. The thermal images are compared with the same model, so that their rig is off by the same motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch

from rtgs.images.filters import to_gray
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.capture import Frame
from rtgs.records.rig import Rig
from rtgs.scale.free_rig import EVERYTHING, FreeRig, FreeRigLoss
from rtgs.scale.problem import Problem
from rtgs.scale.thermal_targets import Pictures


def model_bias(problem: Problem, depth: float, indices: Sequence[int]) -> FreeRig:
    """The motion of the RGB camera under which the model agrees best with photographs, at the thermal camera's pixels per degree.

    Args:
        problem: of the rig. depth: of things, in world units. indices: of its frames that are compared.
    """
    rgb, share = problem.scene.rig.rgb, min(1.0, problem.scene.rig.thermal.fl_x / problem.scene.rig.rgb.fl_x)
    camera = rgb.resized(max(3, round(rgb.width * share)), max(3, round(rgb.height * share)))
    frames = tuple(_photograph(problem.frames[i], camera) for i in indices)
    nowhere = FreeRig(np.eye(3), np.zeros(3), 0.0)
    capture = replace(
        problem.scene.capture,
        rig=Rig(rgb, camera, SE3(nowhere.rotation, np.array([1.0, 0.0, 0.0]))),
        frames=frames,
        thermal_mask=np.ones((camera.height, camera.width), dtype=bool),
    )
    photographs = replace(
        problem,
        scene=replace(problem.scene, capture=capture),
        frames=frames,
        comparison=replace(problem.comparison, without_pattern=False),
    )
    loss = FreeRigLoss.of(Pictures.of(photographs), depth, problem.progress).finest_only()
    return loss.descend(0, range(len(frames)), nowhere, EVERYTHING).rig


def _photograph(frame: Frame, camera: Camera) -> Frame:
    """The frame with its gray photograph as the thermal image."""
    small = cv2.resize(frame.rgb, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return frame.with_thermal(to_gray(torch.from_numpy(small)).numpy().astype(np.float32))
