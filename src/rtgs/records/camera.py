"""One camera's intrinsics and lens.

Pixel `(i, j)` has its centre at `(i + 0.5, j + 0.5)`; `cx`, `cy` mean that (COLMAP's convention), and resizing keeps it. OpenCV
puts centres at integers, so every call into it here shifts by half a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
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


INTRINSICS = ("fl_x", "fl_y", "cx", "cy")  # names of the fields of `Camera` that scale with the picture


@dataclass(frozen=True)
class Camera:
    """Intrinsics, in pixels.

    Attributes:
        model: COLMAP's name, a key of `DISTORTION_OF_MODEL`.
        width, height: image size.
        fl_x, fl_y: focal lengths.
        cx, cy: principal point, pixel centres at half integers.
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
    def distortion(self) -> tuple[float, ...]:
        """The lens terms that `model` names, in COLMAP's order."""
        return tuple(float(getattr(self, name)) for name in DISTORTION_OF_MODEL[self.model])

    @property
    def has_distortion(self) -> bool:
        """Whether undistorting would move a pixel. A fisheye moves them even with all its terms at zero."""
        return self.model == "OPENCV_FISHEYE" or any(k != 0.0 for k in self.distortion)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """`[3, 3]` intrinsic matrix K."""
        return np.array([[self.fl_x, 0.0, self.cx], [0.0, self.fl_y, self.cy], [0.0, 0.0, 1.0]])

    @property
    def opencv_matrix(self) -> NDArray[np.float64]:
        """`[3, 3]`: `matrix` in OpenCV's coordinates, which put pixel centres at integers."""
        matrix = self.matrix
        matrix[:2, 2] -= 0.5
        return matrix

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels `[..., 2]` of points `[..., 3]` in camera axes, without the lens; meaningless where z is not above 0."""
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        return np.stack([self.fl_x * x / z + self.cx, self.fl_y * y / z + self.cy], axis=-1)

    def pinhole(self) -> Camera:
        """The same focal lengths, centre and size without the lens."""
        return Camera("PINHOLE", self.width, self.height, self.fl_x, self.fl_y, self.cx, self.cy)

    def resized(self, width: int, height: int) -> Camera:
        """The camera of the same image resampled to `width` × `height`; each axis keeps its own exact factor."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fl_x=self.fl_x * sx, fl_y=self.fl_y * sy, cx=self.cx * sx, cy=self.cy * sy
        )

    def reduced(self, factor: int) -> Camera:
        """The camera of `images.filters.downsample(picture, factor)`.

        Only whole blocks of pixels count, so the size may round down. The focal lengths are divided exactly.
        """
        parameters = {k: getattr(self, k) / factor for k in INTRINSICS}
        return replace(self, width=self.width // factor, height=self.height // factor, **parameters)

    def rows(self, every: int) -> Camera:
        """The camera of `picture[every // 2 :: every]`."""
        first = every // 2
        height = len(range(first, self.height, every))
        return replace(self, height=height, fl_y=self.fl_y / every, cy=(self.cy - first - 0.5) / every + 0.5)


@dataclass(frozen=True, eq=False)
class Undistortion:
    """The resampling that takes a camera's images to those of `camera.pinhole()`: same focal lengths, centre and size.

    Attributes:
        camera: the camera with its lens.
    """

    camera: Camera

    @cached_property
    def _map(self) -> NDArray[np.float32]:
        """`[H, W, 2]`: for each undistorted pixel where to read, in OpenCV's coordinates (pixel centres at integers)."""
        cam = self.camera
        k_cv = cam.opencv_matrix
        size = (cam.width, cam.height)
        if cam.model == "OPENCV_FISHEYE":
            x, y = cv2.fisheye.initUndistortRectifyMap(k_cv, np.array(cam.distortion), np.eye(3), k_cv, size, cv2.CV_32FC1)
        else:
            lens = np.array([cam.k1, cam.k2, cam.p1, cam.p2])  # RADIAL and its like are OPENCV with zeros
            x, y = cv2.initUndistortRectifyMap(k_cv, lens, np.eye(3), k_cv, size, cv2.CV_32FC1)
        return np.stack([x, y], axis=-1)

    @cached_property
    def mask(self) -> NDArray[np.bool_]:
        """`[H, W]` bool: undistorted pixels whose source lies on the sensor, where the lens model can be trusted."""
        cam = self.camera
        if not cam.has_distortion:
            return np.ones((cam.height, cam.width), dtype=bool)
        x, y = self._map[..., 0], self._map[..., 1]
        # The sensor ends half a pixel beyond the outermost pixel centres.
        on_sensor = (x >= -0.5) & (x <= cam.width - 0.5) & (y >= -0.5) & (y <= cam.height - 0.5)
        return on_sensor & (self._radius() < _fold_radius(cam))

    def apply(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        """Undistort `[H, W]` or `[H, W, C]` float32, bilinearly; pixels outside `mask` repeat the border.

        Without distortion the image comes back as it is, not resampled.
        """
        if image.shape[:2] != (self.camera.height, self.camera.width):
            raise ValueError(f"image is {image.shape[1]}×{image.shape[0]}, camera {self.camera.width}×{self.camera.height}")
        if not self.camera.has_distortion:
            return image
        x, y = self._map[..., 0], self._map[..., 1]
        # OpenCV 5 interpolates float32 exactly; 4.x rounds where it reads to 1/32 pixel.
        return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), dtype=np.float32)

    def _radius(self) -> NDArray[np.float64]:
        """`[H, W]`: tangent of the angle between each undistorted pixel's ray and the optical axis."""
        cam = self.camera
        x = (np.arange(cam.width) + 0.5 - cam.cx) / cam.fl_x
        y = (np.arange(cam.height) + 0.5 - cam.cy) / cam.fl_y
        return np.hypot(x[None, :], y[:, None])


def _fold_radius(camera: Camera) -> float:
    """Undistorted radius (tangent of the ray's angle) where the radial polynomial turns back; infinity if it never does.

    Beyond it two rays share a pixel and the model, fitted inside the image, says nothing.
    """
    if camera.model == "OPENCV_FISHEYE":  # dθ_d/dθ as a polynomial in θ²
        slope = [9 * camera.k4, 7 * camera.k3, 5 * camera.k2, 3 * camera.k1, 1.0]
    else:  # dr_d/dr as a polynomial in r²
        slope = [5 * camera.k2, 3 * camera.k1, 1.0]
    roots = np.roots(slope)
    squared = roots[(np.abs(roots.imag) < 1e-12) & (roots.real > 0)].real
    if squared.size == 0:
        return float("inf")
    first = float(np.sqrt(squared.min()))
    if camera.model == "OPENCV_FISHEYE":
        return float(np.tan(first)) if first < np.pi / 2 else float("inf")
    return first
