"""The fused SSIM against its torch specification, torchmetrics, and finite differences."""

from __future__ import annotations

import pytest
import torch
from tests.helpers.gradients import gradient_of
from torchmetrics.functional.image import structural_similarity_index_measure

from rtgs.losses.ssim import RADIUS_PX, reference_ssim, reference_ssim_map, ssim, whole_windows

# Widths that fit one kernel tile, fill it exactly (1024 floats), and spill into a second; heights that leave a ragged band.
SHAPES = [(11, 11, 1), (11, 40, 3), (29, 23, 3), (17, 1034, 1), (19, 400, 3), (24, 31, 2)]


def pair(shape: tuple[int, int, int], seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """A smooth-plus-noise target and a perturbed copy: flat and busy windows both occur."""
    generator = torch.Generator().manual_seed(seed)
    h, w, _ = shape
    y, x = torch.meshgrid(torch.linspace(0, 6, h), torch.linspace(0, 9, w), indexing="ij")
    b = (0.5 + 0.3 * torch.sin(x + y))[..., None] + 0.1 * torch.rand(shape, generator=generator) * (x > 4)[..., None]
    a = (b + 0.2 * torch.rand(shape, generator=generator) - 0.1).clamp(0, 1)
    return a, b.clamp(0, 1)


def half_mask(shape: tuple[int, int, int]) -> torch.Tensor:
    mask = torch.rand(shape[:2], generator=torch.Generator().manual_seed(3)) > 0.4
    mask[shape[0] // 2, shape[1] // 2] = True
    return mask


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_value_and_gradient_equal_the_reference(shape: tuple[int, int, int], masked: bool) -> None:
    a, b = pair(shape)
    mask = half_mask(shape) if masked else None
    fast, slow = a.clone().requires_grad_(), a.double().requires_grad_()
    value, expected = ssim(fast, b, mask), reference_ssim(slow, b.double(), mask)
    (3 * value).backward()
    (3 * expected).backward()
    # float32 moments of values below 1 carry 6e-8; the variances are divided by C2 = 9e-4, so ~1e-4 of S where the image is flat.
    assert abs(value.item() - expected.item()) < 1e-4
    scale = gradient_of(slow).abs().max()
    assert scale > 0
    torch.testing.assert_close(gradient_of(fast).double(), gradient_of(slow), rtol=0, atol=1e-3 * scale.item())


def test_reference_gradient_equals_finite_differences() -> None:
    a, b = pair((13, 14, 2))
    a, b = a.double().requires_grad_(), b.double()
    torch.autograd.gradcheck(lambda x: ssim(x, b, half_mask((13, 14, 2))), a)


def test_fused_gradient_equals_finite_differences() -> None:
    a, b = pair((30, 30, 3))
    direction = torch.randn(a.shape, generator=torch.Generator().manual_seed(1)).sign()
    leaf = a.clone().requires_grad_()
    ssim(leaf, b).backward()
    h = 1e-3
    slope = (ssim(a + h * direction, b) - ssim(a - h * direction, b)).item() / (2 * h)
    assert (gradient_of(leaf) * direction).sum().item() == pytest.approx(slope, rel=1e-2)


@pytest.mark.parametrize("channels", [1, 3])
def test_agrees_with_torchmetrics_inside_the_frame_it_reflects(channels: int) -> None:
    a, b = (x.double() for x in pair((40, 52, channels)))
    _, theirs = structural_similarity_index_measure(
        a.permute(2, 0, 1)[None], b.permute(2, 0, 1)[None], data_range=1.0, sigma=1.5, return_full_image=True
    )
    interior = theirs[0, :, RADIUS_PX:-RADIUS_PX, RADIUS_PX:-RADIUS_PX].permute(1, 2, 0)
    torch.testing.assert_close(reference_ssim_map(a, b), interior, rtol=0, atol=1e-6)  # their window is float32-exact only
    assert ssim(a.float(), b.float()).item() == pytest.approx(interior.mean().item(), abs=1e-4)


def test_laws() -> None:
    a, b = pair((32, 32, 3))
    assert ssim(b, b).item() == pytest.approx(1.0, abs=1e-6)
    assert ssim(a, b).item() == pytest.approx(ssim(b, a).item(), abs=1e-6)
    assert ssim(a.flip(0), b.flip(0)).item() == pytest.approx(ssim(a, b).item(), abs=1e-6)
    assert ssim(a.transpose(0, 1), b.transpose(0, 1)).item() == pytest.approx(ssim(a, b).item(), abs=1e-6)  # non-contiguous too
    # Constant images p and q: only the luminance term is left.
    p, q = 0.2, 0.7
    expected = (2 * p * q + 1e-4) / (p * p + q * q + 1e-4)
    assert ssim(torch.full((20, 20, 1), p), torch.full((20, 20, 1), q)).item() == pytest.approx(expected, abs=1e-4)


def test_gradient_vanishes_at_the_target_and_nowhere_else() -> None:
    a, b = pair((32, 32, 3))
    leaf = b.clone().requires_grad_()
    ssim(leaf, b).backward()
    assert gradient_of(leaf).abs().max() < 1e-6
    leaf = a.clone().requires_grad_()
    ssim(leaf, b).backward()
    assert (gradient_of(leaf) != 0).all()  # corners as well: their windows reach them


def test_nan_stays_visible() -> None:
    a, b = pair((32, 32, 3))
    a[16, 16, 1] = float("nan")
    leaf = a.requires_grad_()
    value = ssim(leaf, b)
    value.backward()
    assert value.isnan() and gradient_of(leaf)[16, 16, 1].isnan()


def test_mask_is_the_mean_over_centred_windows() -> None:
    a, b = pair((32, 40, 3))
    mask = half_mask((32, 40, 3))
    inside = mask[RADIUS_PX:-RADIUS_PX, RADIUS_PX:-RADIUS_PX]
    assert ssim(a, b, mask).item() == pytest.approx(reference_ssim_map(a, b)[inside].mean().item(), abs=1e-5)
    assert ssim(a, b, torch.ones(32, 40, dtype=torch.bool)).item() == pytest.approx(ssim(a, b).item(), abs=1e-6)


def test_whole_windows_shut_out_what_lies_outside_the_mask() -> None:
    a, b = pair((40, 40, 1))
    mask = torch.ones(40, 40, dtype=torch.bool)
    mask[:, 25:] = False
    spoiled = torch.where(mask[..., None], a, torch.zeros(()))
    centres = whole_windows(mask)
    assert centres[5:-5, 5:20].all() and not centres[:, 20:].any() and not centres[:5].any()
    assert ssim(spoiled, b, centres).item() == pytest.approx(ssim(a, b, centres).item(), abs=1e-6)
    leaf = a.clone().requires_grad_()
    ssim(leaf, b, centres).backward()
    gradient = gradient_of(leaf)
    assert (gradient[:, 25:] == 0).all() and (gradient[10:30, 10:20] != 0).all()


def test_target_gets_no_gradient_and_value_needs_none() -> None:
    a, b = pair((16, 16, 3))
    b.requires_grad_()
    assert not ssim(a, b).requires_grad
    a.requires_grad_()
    ssim(a, b).backward()
    assert b.grad is None and a.grad is not None


@pytest.mark.parametrize(
    ("a", "b", "mask", "says"),
    [
        ((12, 12, 3), (12, 13, 3), None, "one shape"),
        ((12, 12), (12, 12), None, "H, W, C"),
        ((10, 30, 3), (10, 30, 3), None, "at least 11"),
        ((12, 12, 3), (12, 12, 3), torch.ones(12, 11, dtype=torch.bool), "mask is"),
        ((12, 12, 3), (12, 12, 3), torch.ones(12, 12), "mask is"),
        ((12, 12, 3), (12, 12, 3), torch.zeros(12, 12, dtype=torch.bool), "no window"),
    ],
)
def test_impossible_requests_are_refused(a: tuple, b: tuple, mask: torch.Tensor | None, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        ssim(torch.zeros(a), torch.zeros(b), mask)
