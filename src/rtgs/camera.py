"""One camera's intrinsics and lens.

Pixel `(i, j)` has its centre at `(i + 0.5, j + 0.5)`; `cx`, `cy` mean that (COLMAP's convention), and resizing keeps it. OpenCV puts
centres at integers, so every call into it here shifts by half a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

# COLMAP's parameter order after the focal lengths and the principal point.
DISTORTION_OF_MODEL: dict[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": (),
    "PINHOLE": (),
    "SIMPLE_RADIAL": ("k1",),
    "RADIAL": ("k1", "k2"),
    "OPENCV": ("k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4"),
}


@dataclass(frozen=True)
class Camera:
    """Intrinsics, in pixels.

    Attributes:
        model: COLMAP's name, a key of `DISTORTION_OF_MODEL`.
        width, height: image size.
        fl_x, fl_y: focal lengths. cx, cy: principal point, pixel centres at half integers.
        k1 … p2: lens distortion; those a model does not name are zero.
    """

    model: str
    width: int
    height: int
    fl_x: float
    fl_y: float
    cx: float
    cy: float
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    @property
    def matrix(self) -> NDArray[np.float64]:
        """`[3, 3]` intrinsic matrix K."""
        return np.array([[self.fl_x, 0.0, self.cx], [0.0, self.fl_y, self.cy], [0.0, 0.0, 1.0]])

    def pinhole(self) -> Camera:
        """The same focal lengths, centre and size without the lens."""
        return Camera("PINHOLE", self.width, self.height, self.fl_x, self.fl_y, self.cx, self.cy)

    def resized(self, width: int, height: int) -> Camera:
        """The camera of the same image resampled to `width` × `height`; each axis keeps its own exact factor."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fl_x=self.fl_x * sx, fl_y=self.fl_y * sy, cx=self.cx * sx, cy=self.cy * sy
        )
