"""The scale's rivals: losses of a gray render against a thermal image, and their slopes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.ndimage import gaussian_filter

from rtgs.experiments.rivals import INERF_L1, INERF_SSIM, MUTUAL_INFORMATION, NGF_PYRAMID, NGF_SINGLE, RIVALS, Rival
from rtgs.losses.ngf import NgfPyramid, ngf_loss
from rtgs.losses.ssim import reference_ssim

SHAPE = (44, 56)
Images = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]


@pytest.fixture(scope="module")
def images() -> Images:
    """Gray render, thermal image and tangent, all smooth, the first two well inside of [0, 1]."""
    rng = np.random.default_rng(4)
    gray, thermal, tangent = (gaussian_filter(rng.normal(size=SHAPE), 2.0) for _ in range(3))
    render, photo = (0.5 + 0.15 * image / image.std() for image in (gray, thermal))
    return render.astype(np.float32), photo.astype(np.float32), (tangent / tangent.std()).astype(np.float32)


def masks() -> dict[str, NDArray[np.bool_]]:
    hole = np.ones(SHAPE, bool)
    hole[:9, 30:] = False
    return {"all": np.ones(SHAPE, bool), "hole": hole}


@pytest.mark.parametrize("mask", masks())
@pytest.mark.parametrize("rival", RIVALS, ids=lambda r: r.key)
def test_slope_is_the_losses_change(rival: Rival, mask: str, images: Images) -> None:
    gray, thermal, tangent = images
    loss = rival.loss(thermal, masks()[mask])
    _, slope = loss(gray, tangent)
    h = np.float32(2e-4)  # float32 losses: smaller steps drown in rounding
    change = (loss(gray + h * tangent, tangent)[0] - loss(gray - h * tangent, tangent)[0]) / (2 * float(h))
    assert slope == pytest.approx(change, rel=0.03, abs=2e-3 * abs(loss(gray, tangent)[0]))
    assert abs(slope) > 1e-4, "nothing was compared"


@pytest.mark.parametrize("rival", RIVALS, ids=lambda r: r.key)
def test_what_the_mask_leaves_out_does_not_count(rival: Rival, images: Images) -> None:
    gray, thermal, tangent = images
    mask = masks()["hole"]
    other = np.where(mask, thermal, 0.9).astype(np.float32)
    assert rival.loss(other, mask)(gray, tangent) == pytest.approx(rival.loss(thermal, mask)(gray, tangent), rel=1e-5)
    assert rival.loss(other, masks()["all"])(gray, tangent)[0] != pytest.approx(rival.loss(thermal, mask)(gray, tangent)[0])


@pytest.mark.parametrize("rival", RIVALS, ids=lambda r: r.key)
def test_the_image_itself_is_best(rival: Rival, images: Images) -> None:
    gray, thermal, tangent = images
    loss = rival.loss(thermal, masks()["all"])
    own = loss(thermal, tangent)[0]
    assert own < loss(gray, tangent)[0] and own < loss(np.roll(thermal, 3, axis=1), tangent)[0]


def test_values_are_those_defined_elsewhere(images: Images) -> None:
    gray, thermal, tangent = images
    mask = masks()["hole"]
    a, b, m = (torch.from_numpy(x) for x in (gray, thermal, mask))
    whole = masks()["all"]
    assert INERF_L1.loss(thermal, mask)(gray, tangent)[0] == pytest.approx(np.abs(gray - thermal)[mask].mean(), rel=1e-5)
    similarity = float(reference_ssim(a[..., None].double(), b[..., None].double()))
    assert INERF_SSIM.loss(thermal, whole)(gray, tangent)[0] == pytest.approx(1 - similarity, rel=1e-4)
    assert NGF_SINGLE.loss(thermal, mask)(gray, tangent)[0] == pytest.approx(float(ngf_loss(a, b, mask=m)), rel=1e-4)
    assert NGF_PYRAMID.loss(thermal, mask)(gray, tangent)[0] == pytest.approx(float(NgfPyramid.of(b, m)(a)), rel=1e-4)


def test_mutual_information_against_a_histogram_written_out(images: Images) -> None:
    """Mattes: one of 50 bins for the fixed image, a cubic B-spline over four for the moving one, two bins of padding."""
    gray, thermal, tangent = images
    kernel = BSpline.basis_element(np.arange(-2, 3))
    joint = np.zeros((50, 50))
    lo, hi = thermal.min(), thermal.max()
    for a, b in zip(gray.ravel().astype(float), thermal.ravel().astype(float), strict=True):
        distance = np.arange(50) - (2 + 46 * a)
        weights = np.where(np.abs(distance) < 2, kernel(np.clip(distance, -2, 2)), 0.0)
        joint[min(int(2 + 46 * (b - lo) / (hi - lo)), 47)] += weights
    joint /= joint.sum()
    independent = joint.sum(1, keepdims=True) * joint.sum(0, keepdims=True)
    expected = (joint[joint > 0] * np.log(joint[joint > 0] / independent[joint > 0])).sum()
    assert MUTUAL_INFORMATION.loss(thermal, masks()["all"])(gray, tangent)[0] == pytest.approx(-expected, rel=1e-4)


def test_mutual_information_forgives_any_contrast(images: Images) -> None:
    """A bijection of the fixed image's bins leaves it as it is; ℓ1 and SSIM it does not."""
    gray, thermal, tangent = images
    whole = masks()["all"]
    flipped = (thermal.max() + thermal.min() - thermal).astype(np.float32)
    same, other = (MUTUAL_INFORMATION.loss(t, whole)(gray, tangent)[0] for t in (thermal, flipped))
    assert same == pytest.approx(other, rel=0.02)
    for rival in (INERF_L1, INERF_SSIM):
        assert rival.loss(flipped, whole)(thermal, tangent)[0] > 3 * rival.loss(thermal, whole)(thermal, tangent)[0] + 0.1


def test_renders_beyond_the_range_are_clamped() -> None:
    thermal = np.linspace(0, 1, SHAPE[0] * SHAPE[1], dtype=np.float32).reshape(SHAPE)
    loss = MUTUAL_INFORMATION.loss(thermal, masks()["all"])
    value, slope = loss(np.full(SHAPE, 1.7, np.float32), np.ones(SHAPE, np.float32))
    assert value == pytest.approx(0.0, abs=1e-12) and slope == 0.0
