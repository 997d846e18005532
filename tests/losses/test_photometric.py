"""The fused training loss against its torch specification."""

from __future__ import annotations

import pytest
import torch
from tests.helpers.gradients import gradient_of
from torch import Tensor

from rtgs.losses.photometric import Appearance, Target, photometric, reference_photometric
from rtgs.losses.ssim import whole_windows

NAMES = ("color", "alpha", "background", "gain", "offset")


def view(height: int = 46, width: int = 61) -> tuple[dict[str, Tensor], Tensor]:
    """A view that resembles a smooth target with some noise, half transparent at the left."""
    g = torch.Generator().manual_seed(0)
    y, x = torch.meshgrid(torch.linspace(0, 5, height), torch.linspace(0, 7, width), indexing="ij")
    target = (
        0.5 + 0.3 * torch.sin(torch.stack([x + y, x - y, 2 * x], -1)) + 0.1 * torch.rand(height, width, 3, generator=g)
    ).clamp(0, 1)
    alpha = (0.4 + 0.1 * x).clamp(0, 1) * (0.9 + 0.1 * torch.rand(height, width, generator=g))
    color = alpha[..., None] * (target + 0.15 * torch.rand(height, width, 3, generator=g) - 0.05)
    tensors = (color, alpha, torch.rand(3, generator=g), torch.tensor([1.1, 0.9, 1.0]), torch.tensor([0.01, -0.02, 0.03]))
    return dict(zip(NAMES, tensors, strict=True)), target


def of(tensors: dict[str, Tensor]) -> tuple[Tensor, Tensor, Appearance]:
    """The arguments of a loss."""
    color, alpha, *appearance = (tensors[name] for name in NAMES)
    return color, alpha, Appearance(*appearance)


def border(height: int = 46, width: int = 61) -> tuple[Tensor, Tensor]:
    pixels = torch.ones(height, width, dtype=torch.bool)
    pixels[:4], pixels[:, 50:], pixels[20, 20] = False, False, False
    return pixels, whole_windows(pixels)


@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("ssim_weight", [0.0, 0.2])
def test_value_and_gradients_equal_the_reference(ssim_weight: float, masked: bool) -> None:
    tensors, target = view()
    pixels, windows = border() if masked else (None, None)
    slow = {k: v.double().requires_grad_() for k, v in tensors.items()}
    expected = reference_photometric(*of(slow), Target(target.double(), pixels, windows), ssim_weight=ssim_weight)
    (3 * expected).backward()
    # Even and odd rows together are all rows: with a mask that favours neither, their mean is the loss over all.
    values, sums = [], {k: torch.zeros_like(v) for k, v in tensors.items()}
    for parity in (0, 1):
        fast = {k: v.clone().requires_grad_() for k, v in tensors.items()}
        loss = photometric(*of(fast), Target(target, pixels, windows), ssim_weight=ssim_weight, parity=parity)
        (3 * loss).backward()
        values.append(loss.item())
        for name, tensor in fast.items():
            sums[name] += gradient_of(tensor) / 2
    # With the mask, even and odd rows hold 15 and 16 rows of windows: their means are not weighed by that.
    assert sum(values) / 2 == pytest.approx(expected.item(), rel=1e-3 if masked else 1e-6)
    for name, tensor in slow.items():
        gradient = gradient_of(tensor)
        assert gradient.norm() > 0
        error = (sums[name].double() - gradient).norm() / gradient.norm()
        assert error < (0.03 if masked and ssim_weight else 1e-3), name  # at |difference| ~ 1e-8 float32 has another sign


def test_every_second_row_of_windows_is_nearly_all() -> None:
    tensors, target = view(120, 160)
    gradients = []
    for parity in (0, 1):
        color = tensors["color"].clone().requires_grad_()
        photometric(*of({**tensors, "color": color}), Target(target), ssim_weight=1.0, parity=parity).backward()
        gradients.append(gradient_of(color))
    assert 0 < (gradients[0] - gradients[1]).norm() < 0.1 * gradients[0].norm()


def test_what_the_mask_leaves_out_has_no_say() -> None:
    tensors, target = view()
    pixels, windows = border()
    spoiled = torch.where(pixels[..., None], target, 1.0 - target)
    results = []
    for picture in (target, spoiled):
        leaves = {k: v.clone().requires_grad_() for k, v in tensors.items()}
        loss = photometric(*of(leaves), Target(picture, pixels, windows), ssim_weight=0.2)
        loss.backward()
        results.append([loss, *(gradient_of(leaf) for leaf in leaves.values())])
        assert not gradient_of(leaves["color"])[~pixels].any() and not gradient_of(leaves["alpha"])[~pixels].any()
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))


def test_a_mask_that_leaves_one_row_of_windows_is_used_at_either_parity() -> None:
    tensors, target = view()
    windows = torch.zeros(46, 61, dtype=torch.bool)
    windows[17, 10:40] = True
    values = [photometric(*of(tensors), Target(target, windows=windows), ssim_weight=0.2, parity=parity) for parity in (0, 1)]
    expected = reference_photometric(*of(tensors), Target(target, windows=windows), ssim_weight=0.2)
    torch.testing.assert_close(torch.stack(values), expected.expand(2))


def test_an_image_smaller_than_the_window_is_refused() -> None:
    tensors, target = view(10, 40)
    with pytest.raises(ValueError, match="11 px"):
        photometric(*of(tensors), Target(target), ssim_weight=0.2)


def test_what_is_not_a_number_stays_visible() -> None:
    tensors, target = view()
    tensors["color"][30, 30, 1] = float("nan")
    assert photometric(*of(tensors), Target(target), ssim_weight=0.2).isnan()
