"""Pictures as tensors: gray, derivative filters, block means, masks and blur."""

from __future__ import annotations

import math

import cv2
import numpy as np
import torch
from scipy import ndimage
from scipy.ndimage import gaussian_filter
from tests.helpers.textures import ramp, textured

from rtgs.images.filters import blurred, downsample, downsample_mask, erode_for_sobel, sobel, to_gray


def test_sobel_equals_opencv_and_scipy() -> None:
    image = textured(24, 31)
    gx, gy = sobel(image)
    inner = (slice(1, -1), slice(1, -1))
    for gradient, order, axis in ((gx, (1, 0), 1), (gy, (0, 1), 0)):
        np.testing.assert_allclose(gradient, cv2.Sobel(image.numpy(), cv2.CV_64F, *order)[inner], atol=1e-12)
        np.testing.assert_allclose(gradient, ndimage.sobel(image.numpy(), axis=axis)[inner], atol=1e-12)


def test_smoothed_otherwise_it_is_scharrs_or_a_central_difference() -> None:
    image = textured(24, 31)
    inner = (slice(1, -1), slice(1, -1))
    gx, gy = sobel(image, (0.75, 2.5))
    for gradient, order in ((gx, (1, 0)), (gy, (0, 1))):
        np.testing.assert_allclose(4 * gradient, cv2.Scharr(image.numpy(), cv2.CV_64F, *order)[inner], atol=1e-12)
    gx, gy = sobel(image, (0.0, 4.0))
    torch.testing.assert_close(gx, 4 * (image[1:-1, 2:] - image[1:-1, :-2]))
    torch.testing.assert_close(gy, 4 * (image[2:, 1:-1] - image[:-2, 1:-1]))


def test_sobel_of_a_ramp_is_eight_times_its_slope() -> None:
    gx, gy = sobel(ramp(9, 7, (3.0, -2.0)))
    torch.testing.assert_close(gx, torch.full((7, 5), 8 * 3.0 / 50, dtype=torch.float64))
    torch.testing.assert_close(gy, torch.full((7, 5), -8 * 2.0 / 50, dtype=torch.float64))


def test_gray_is_bt601() -> None:
    rgb = torch.rand(4, 5, 3, generator=torch.Generator().manual_seed(0))
    expected = cv2.cvtColor(rgb.numpy(), cv2.COLOR_RGB2GRAY)
    np.testing.assert_allclose(to_gray(rgb), expected, atol=1e-6)


def test_downsample_is_the_block_mean_without_the_rest() -> None:
    image = textured(23, 30)
    expected = [[image[y * 4 : y * 4 + 4, x * 4 : x * 4 + 4].mean() for x in range(7)] for y in range(5)]
    torch.testing.assert_close(downsample(image, 4), torch.tensor(expected))
    assert downsample(torch.rand(8, 6, 3), 2).shape == (4, 3, 3)
    assert downsample(image, 1) is image


def test_masks_keep_only_whole_blocks_and_whole_neighbourhoods() -> None:
    mask = torch.ones(9, 12, dtype=torch.bool)
    mask[4, 7] = False
    expected = torch.ones(4, 6, dtype=torch.bool)
    expected[2, 3] = False
    assert torch.equal(downsample_mask(mask, 2), expected)
    eroded = torch.from_numpy(ndimage.binary_erosion(mask.numpy(), np.ones((3, 3)), border_value=1))
    assert torch.equal(erode_for_sobel(mask), eroded[1:-1, 1:-1])


def test_a_picture_is_blurred_as_scipy_does() -> None:
    image = np.random.default_rng(0).normal(size=(2, 30, 41))
    for sigma in (0.7, 2.0):
        expected = [gaussian_filter(plane, sigma, mode="nearest", radius=math.ceil(3 * sigma)) for plane in image]
        np.testing.assert_allclose(blurred(torch.from_numpy(image), sigma), expected, atol=1e-12)
