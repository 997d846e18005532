"""By how many thermal pixels the baseline moves what the images show, before any model: RGB warped to the thermal camera by planes.

For each of a series of distances the RGB picture is warped as if all of it lay there. Where the edges of a block of the thermal image
meet those of the warped picture best, the block has its flow. Blocks vote, as clearly as their best distance stands out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.doctor.patient import Look
from rtgs.records.camera import Camera
from rtgs.records.rig import Rig

_WIDTH = 200  # of the small thermal images
_FRAMES = 12
_MOST = 0.3  # largest flow, as a share of the width
_BLOCKS = (5, 6)
_SMOOTH = 1.0  # votes, in steps

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Disparity:
    """Flow of the baseline in pixels of the full thermal image.

    Attributes:
        flow_px: where most votes are. votes: the share of the votes near it. share: what chance alone would give.
    """

    flow_px: float
    votes: float
    share: float

    @property
    def clear(self) -> bool:
        """Whether the votes meet at one flow rather than anywhere."""
        return self.votes > 2 * self.share


def find_disparity(looks: Sequence[Look], rig: Rig) -> Disparity:
    """The flow that most blocks of the thermal images vote for."""
    thermal = _small(rig.thermal, _WIDTH)
    height, width = looks[0].grey.shape
    rgb = rig.rgb.resized(width, height)
    steps = np.arange(0.0, _MOST * thermal.width, 1.0)
    speed = _flow_of_unit(rig, thermal)
    total = np.zeros(len(steps))
    for look in looks[:: max(1, len(looks) // _FRAMES)][:_FRAMES]:
        resized = cv2.resize(look.thermal, (thermal.width, thermal.height), interpolation=cv2.INTER_AREA)
        warm = np.asarray(resized, dtype=np.float32)
        scores = _scores(warm, look.grey, rgb, thermal, rig, steps / speed)
        total += _votes(scores)
    smooth = cv2.GaussianBlur(total.reshape(1, -1), (0, 0), _SMOOTH).ravel()
    best = int(smooth.argmax())
    near = np.abs(np.arange(len(steps)) - best) <= 2
    votes = float(total[near].sum() / max(total.sum(), 1e-12))
    return Disparity(float(steps[best]) * rig.thermal.width / thermal.width, votes, float(near.mean()))


def _small(camera: Camera, width: int) -> Camera:
    width = min(width, camera.width)
    return camera.resized(width, max(1, round(camera.height * width / camera.width)))


def _flow_of_unit(rig: Rig, thermal: Camera) -> float:
    """Pixels that something one metre away moves in the middle of the thermal image; along the axis, at a quarter of the width."""
    x, y, z = rig.rgb_from_thermal.rotation.T @ rig.rgb_from_thermal.translation
    return float(max(np.hypot(x, y) * thermal.fl_x, abs(z) * thermal.width / 4, 1e-9))


def _scores(
    warm: NDArray[np.float32], grey: NDArray[np.float32], rgb: Camera, thermal: Camera, rig: Rig, inverse_depths: Array
) -> Array:
    """`[S, blocks]`: how well edges agree with everything at each inverse depth (1/m)."""
    normal = _directions(warm)
    found = []
    for inverse in inverse_depths:
        plane = rig.rgb_from_thermal.rotation + inverse * np.outer(rig.rgb_from_thermal.translation, [0.0, 0.0, 1.0])
        rgb_from_thermal = rgb.opencv_matrix @ plane @ np.linalg.inv(thermal.opencv_matrix)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = cv2.warpPerspective(
            grey, rgb_from_thermal, (thermal.width, thermal.height), flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
        agreement = ((normal * _directions(np.asarray(warped, dtype=np.float32))).sum(axis=0) ** 2).astype(np.float32)
        found.append(cv2.resize(agreement, _BLOCKS[::-1], interpolation=cv2.INTER_AREA).ravel())
    return np.stack(found).astype(np.float64)


def _directions(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """`[2, h, w]`: gradients divided by their length, but for weak ones."""
    soft = cv2.GaussianBlur(image, (0, 0), 1.0)
    gradient = np.stack([cv2.Sobel(soft, cv2.CV_32F, 1, 0), cv2.Sobel(soft, cv2.CV_32F, 0, 1)])
    size = np.hypot(gradient[0], gradient[1])
    return np.asarray(gradient / np.sqrt(size**2 + max(float(size.mean()), 1e-12) ** 2), dtype=np.float32)


def _votes(scores: Array) -> Array:
    """`[S]`: each block for its best flow, as much as that stands out."""
    outstanding = scores.max(axis=0) - np.median(scores, axis=0)
    votes = np.zeros(len(scores))
    np.add.at(votes, scores.argmax(axis=0), outstanding)
    return votes
