"""Intrinsics and undistortion: half-pixel centres, all six models, known answers from COLMAP."""

from __future__ import annotations

import numpy as np
import pytest

from rtgs.io.colmap import colmap_camera
from rtgs.records.camera import DISTORTION_OF_MODEL, Camera, Undistortion

TERMS = {
    "SIMPLE_PINHOLE": {},
    "PINHOLE": {},
    "SIMPLE_RADIAL": {"k1": -0.1},
    "RADIAL": {"k1": -0.1, "k2": 0.02},
    "OPENCV": {"k1": -0.1, "k2": 0.02, "p1": 0.003, "p2": -0.002},
    "OPENCV_FISHEYE": {"k1": 0.02, "k2": -0.01, "k3": 0.003, "k4": -0.001},
}


def camera_of(model: str) -> Camera:
    fl_y = 150.0 if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL") else 155.0
    return Camera(model, 160, 120, 150.0, fl_y, 83.2, 57.9, **TERMS[model])


def smooth_image(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A smooth function of COLMAP's pixel coordinates, known between pixels too."""
    return np.sin(x / 25) + np.cos(y / 20) + 0.5 * np.sin((x + y) / 30)


def pixel_centres(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return x, y


@pytest.mark.parametrize("model", ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"])
def test_no_distortion_is_exactly_the_identity(model: str) -> None:
    camera = Camera(model, 160, 120, 150.0, 150.0, 83.2, 57.9)
    image = np.random.default_rng(0).random((120, 160, 3), dtype=np.float32)
    undistortion = Undistortion(camera)
    np.testing.assert_array_equal(undistortion.apply(image), image)
    assert undistortion.mask.all()


def test_a_vanishing_distortion_moves_nothing() -> None:
    """The resampling itself, half-pixel shifts included, tends to the identity."""
    camera = Camera("OPENCV", 160, 120, 150.0, 150.0, 83.2, 57.9, k1=1e-12)
    image = np.random.default_rng(0).random((120, 160), dtype=np.float32)
    np.testing.assert_allclose(Undistortion(camera).apply(image), image, atol=1e-4)


@pytest.mark.parametrize("model", [m for m in DISTORTION_OF_MODEL if DISTORTION_OF_MODEL[m]])
def test_undistortion_agrees_with_colmap(model: str) -> None:
    """Project with COLMAP's camera, resample with ours: the same to 0.01 px."""
    camera = camera_of(model)
    x, y = pixel_centres(camera)
    rays = np.stack([(x - camera.cx) / camera.fl_x, (y - camera.cy) / camera.fl_y, np.ones_like(x)], axis=-1)
    reference = colmap_camera(camera, 1)
    seen_at = np.array([reference.img_from_cam(ray) for ray in rays.reshape(-1, 3)]).reshape(*x.shape, 2)

    undistortion = Undistortion(camera)
    np.testing.assert_allclose(undistortion._map + 0.5, seen_at, atol=0.002)

    mask = undistortion.mask
    for image, true in ((x, seen_at[..., 0]), (y, seen_at[..., 1])):  # ramps: an error in value is an error in pixels
        error = (undistortion.apply(image.astype(np.float32)) - true)[mask]
        inside = np.abs(error) < 0.25  # the border's half pixel repeats the outermost centre
        assert inside.mean() > 0.97
        assert np.abs(error[inside]).mean() < 0.01
        assert abs(error[inside].mean()) < 0.005
    undistorted = undistortion.apply(smooth_image(x, y).astype(np.float32))
    assert np.abs(undistorted - smooth_image(seen_at[..., 0], seen_at[..., 1]))[mask].max() < 0.03
    assert 0.5 < mask.mean() <= 1


def test_mask_is_what_the_sensor_saw() -> None:
    """Pincushion (k1 > 0): undistorted corners read from outside the sensor. Barrel: every pixel is filled."""
    assert not Undistortion(Camera("SIMPLE_RADIAL", 160, 120, 150.0, 150.0, 80.0, 60.0, k1=0.1)).mask[0, 0]
    assert Undistortion(Camera("SIMPLE_RADIAL", 160, 120, 150.0, 150.0, 80.0, 60.0, k1=-0.1)).mask.all()


def test_mask_leaves_out_where_the_lens_polynomial_folds() -> None:
    """Strong barrel: r (1 + k1 r²) turns back at r = 1/√(−3 k1), and corners beyond would show the inside a second time."""
    camera = Camera("SIMPLE_RADIAL", 200, 200, 80.0, 80.0, 100.0, 100.0, k1=-0.3)
    mask = Undistortion(camera).mask
    fold_px = 80.0 / np.sqrt(0.9)
    assert mask[100, 99]
    assert mask[100, int(100 + fold_px) - 2]
    assert not mask[100, int(100 + fold_px) + 2]


def test_undistortion_checks_the_size() -> None:
    with pytest.raises(ValueError, match="image is 10×20, camera 160×120"):
        Undistortion(camera_of("OPENCV")).apply(np.zeros((20, 10), np.float32))


def test_pinhole_keeps_everything_but_the_lens() -> None:
    camera = camera_of("OPENCV")
    pinhole = camera.pinhole()
    assert (pinhole.model, pinhole.distortion, pinhole.has_distortion) == ("PINHOLE", (), False)
    np.testing.assert_array_equal(pinhole.matrix, camera.matrix)


def test_resizing_keeps_the_pixel_convention() -> None:
    """A ray hits the same fraction of the image; halving maps the centre of a 2×2 block to the centre of one pixel."""
    camera = camera_of("PINHOLE")
    half = camera.resized(80, 60)
    ray = np.array([0.1, -0.05, 1.0])
    at, at_half = camera.matrix @ ray, half.matrix @ ray
    np.testing.assert_allclose(at[:2] / 2, at_half[:2], atol=1e-12)
    odd = camera.resized(107, 80)  # 1.4953… and 1.5: one exact factor an axis
    np.testing.assert_allclose((odd.matrix @ ray)[:2], at[:2] * [107 / 160, 80 / 120], atol=1e-12)
