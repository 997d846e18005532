"""Forward mode: against the reference's dual numbers, against reverse mode, against differences."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.helpers.compare_renders import assert_close
from tests.helpers.gaussian_clouds import POSE, cloud, degenerate, identity, joined, pinhole

from rtgs.base.errors import RtgsError
from rtgs.config import Backend
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import Direction, RenderSettings, render, render_with_tangents

EVERY_WAY = [
    Direction((1.0, 0.0, 0.0)),
    Direction((0.0, 1.0, 0.0)),
    Direction((0.3, -0.2, 1.0), (0.1, 0.2, -0.3)),
    Direction(translation=(1.0, 0.0, 0.0)),
    Direction(translation=(0.0, 1.0, 0.0)),
    Direction(translation=(0.0, 0.0, 1.0)),
    Direction(fl_x=20.0, fl_y=-10.0),
    Direction(cx=1.0, cy=-2.0),
]


def assert_forward_modes_agree(
    gaussians: Gaussians, settings: RenderSettings, pose: SE3 = POSE, tolerance: float = 2e-5, size: tuple[int, int] = (37, 21)
) -> None:
    fast, fast_rates = render_with_tangents(gaussians, pinhole(*size), pose, EVERY_WAY, settings=settings)
    double = gaussians.to(torch.float64)
    slow, slow_rates = render_with_tangents(
        double, pinhole(*size), pose, EVERY_WAY, settings=replace(settings, backend="reference")
    )
    assert_close(fast.color, slow.color, 3e-5, "color")
    assert torch.equal(fast.visible & slow.visible, fast.visible)
    pairs = [("color", fast_rates.color, slow_rates.color), ("alpha", fast_rates.alpha, slow_rates.alpha)]
    if settings.with_depth:
        assert fast_rates.depth is not None and slow_rates.depth is not None
        pairs.append(("depth", fast_rates.depth, slow_rates.depth))
    for name, a, b in pairs:
        assert a.shape == b.shape
        for k, (rate, expected) in enumerate(zip(a, b, strict=True)):
            # As a gradient's: sums of float32 terms of either sign, relative to the largest of the picture.
            assert_close(rate, expected, tolerance * expected.abs().max().item() + 1e-6, f"{name} along {k}")


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize(("degree", "channels"), [(0, 1), (1, 1), (2, 3), (3, 3)])
def test_cpu_equals_reference(degree: int, channels: int, antialiased: bool) -> None:
    settings = RenderSettings(with_depth=degree % 2 == 0, antialiased=antialiased)
    assert_forward_modes_agree(cloud(150, degree, channels, seed=degree), settings)


def test_cpu_equals_reference_in_gray_and_in_fewer_bands() -> None:
    assert_forward_modes_agree(cloud(150, 3, 3), RenderSettings(channel_weights=(0.3, 0.6, 0.1), with_depth=True))
    assert_forward_modes_agree(cloud(150, 3, 3), RenderSettings(sh_degree=1))


@pytest.mark.thorough
def test_cpu_equals_reference_over_many_tiles_and_behind_an_opaque_crowd() -> None:
    assert_forward_modes_agree(cloud(400, 1, 1, size=0.03), RenderSettings(), size=(150, 130))
    crowd = cloud(300, 0, 3, size=0.5)
    crowd = replace(crowd, opacity_logits=crowd.opacity_logits + 3.0)
    assert_forward_modes_agree(crowd, RenderSettings(), tolerance=2e-4)


@pytest.mark.parametrize("kind", ["off screen, reaching in", "tiny", "huge", "flat", "saturated", "long quaternion"])
def test_cpu_equals_reference_on_degenerate_gaussians(kind: str) -> None:
    # "off screen" lies beyond the held slopes, where the bound moves with the intrinsics; a "saturated" α does not move at all.
    shifted = replace(cloud(40, 2, 3), means=cloud(40, 2, 3).means + torch.tensor([0.0, 0.0, 3.0]))
    settings = RenderSettings(near_plane=0.5, antialiased=kind == "off screen, reaching in")
    assert_forward_modes_agree(joined(shifted, degenerate(kind), shifted), settings, identity(), tolerance=1e-4)


@pytest.mark.parametrize("settings", [RenderSettings(), RenderSettings(channel_weights=(0.3, 0.6, 0.1), antialiased=True)])
def test_dot_product_with_reverse_mode(settings: RenderSettings) -> None:
    """⟨y, J·v⟩ = ⟨Jᵀ·y, v⟩ for the pose: what forward mode calls a twist, reverse mode gives as ∂L/∂(R, t)."""
    model, camera = cloud(200, 3, 3), pinhole(45, 33)
    rotation, translation = POSE.rotation.float().requires_grad_(), POSE.translation.float().requires_grad_()
    view = render(model, camera, SE3(rotation, translation), settings=settings)
    g = torch.Generator().manual_seed(5)
    y, y_alpha = torch.randn(view.color.shape, generator=g), torch.randn(view.alpha.shape, generator=g)
    ((view.color * y).sum() + (view.alpha * y_alpha).sum()).backward()
    _, rates = render_with_tangents(model, camera, POSE, EVERY_WAY[:6], settings=settings)
    for k, way in enumerate(EVERY_WAY[:6]):
        x, y_, z = way.rotation_rad
        turn = torch.tensor([[0, -z, y_], [z, 0, -x], [-y_, x, 0]])
        reverse = (rotation.grad * (turn @ rotation.detach())).sum()
        reverse += (translation.grad * (turn @ translation.detach() + torch.tensor(way.translation))).sum()
        forward = (rates.color[k] * y).sum() + (rates.alpha[k] * y_alpha).sum()
        scale = rates.color[k].norm() * y.norm() + rates.alpha[k].norm() * y_alpha.norm()
        assert abs(forward - reverse) <= 1e-6 * scale, k


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_tangents_equal_central_differences(backend: Backend) -> None:
    # Two Gaussians wide and faint enough that no pixel is near a cut-off; float32 differences need a long step.
    model = cloud(2, 3, 1, seed=3, size=1.5)
    model.sh[:, 0] = 1.0
    model = replace(model, opacity_logits=torch.tensor([-0.5, 0.3])).to(
        torch.float64 if backend == "reference" else torch.float32
    )
    settings, camera = RenderSettings(backend=backend), pinhole(20, 16)
    step, tolerance = (1e-5, 1e-8) if backend == "reference" else (1e-2, 3e-4)
    view, rates = render_with_tangents(model, camera, POSE, EVERY_WAY, settings=settings)
    assert view.alpha.min() > 0.05

    def moved(way: Direction, epsilon: float) -> torch.Tensor:
        turned = SE3(
            torch.tensor(rotation_from_axis_angle([epsilon * w for w in way.rotation_rad])),
            epsilon * torch.tensor(way.translation, dtype=torch.float64),
        )
        lens = {k: getattr(camera, k) + epsilon * getattr(way, k) for k in ("fl_x", "fl_y", "cx", "cy")}
        return render(model, replace(camera, **lens), turned @ POSE, settings=settings).color

    for k, way in enumerate(EVERY_WAY):
        # exp(twist) = (rotation, translation + O(ε²)): the difference is central, so ε² cancels.
        difference = (moved(way, step) - moved(way, -step)) / (2 * step)
        assert rates.color[k].abs().max() > 1e-3
        assert_close(rates.color[k], difference, tolerance * max(1.0, difference.abs().max().item()), f"along {k}")


def test_direction_between_poses_is_the_scales() -> None:
    """d/d ln s of Eq. 1's thermal pose, (R, s·t)⁻¹ ∘ rgb_from_world, is a pure translation −s·Rᵀ·t of the thermal camera's frame."""
    rig = SE3(rotation_from_axis_angle([0.02, -0.03, 0.01]), torch.tensor([0.05, 0.01, -0.02], dtype=torch.float64).numpy())
    rgb = SE3(POSE.rotation.numpy(), POSE.translation.numpy())

    def thermal(ln_s: float) -> SE3:
        return rig.with_baseline_scaled(2.718281828459045**ln_s).inverse() @ rgb

    h = 1e-5
    ahead, behind = thermal(0.7 + h), thermal(0.7 - h)
    rate = SE3((ahead.rotation - behind.rotation) / (2 * h), (ahead.translation - behind.translation) / (2 * h))
    found = Direction.between(rate, thermal(0.7))
    expected = -(2.718281828459045**0.7) * (rig.rotation.T @ rig.translation)
    assert found.rotation_rad == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert found.translation == pytest.approx(tuple(expected), abs=1e-8)


def test_direction_between_poses_inverts_a_twist() -> None:
    way = EVERY_WAY[2]
    x, y, z = way.rotation_rad
    turn = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    rate = SE3(turn @ POSE.rotation, turn @ POSE.translation + torch.tensor(way.translation, dtype=torch.float64))
    found = Direction.between(rate, POSE)
    assert found.rotation_rad == pytest.approx(way.rotation_rad) and found.translation == pytest.approx(way.translation)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_over_a_background(backend: Backend) -> None:
    model, camera, background = cloud(80, 1, 3, size=0.05), pinhole(37, 21), torch.tensor([0.2, 0.5, 0.9])
    view, rates = render_with_tangents(model, camera, POSE, EVERY_WAY[3:4], settings=RenderSettings(backend=backend))
    assert_close(rates.over(background)[0], rates.color[0] - rates.alpha[0][..., None] * background, 0.0, "over")
    # A wall in the background's colour, far behind: its own motion aside, the same derivative.
    assert view.alpha.min() < 0.5 and rates.alpha[0].abs().max() > 0.1


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_nothing_to_see_does_not_move(backend: Backend) -> None:
    behind = replace(cloud(5), means=cloud(5).means - torch.tensor([0.0, 0.0, 50.0]))
    for model in (cloud(0), behind):
        _, rates = render_with_tangents(model, pinhole(20, 18), POSE, EVERY_WAY, settings=RenderSettings(backend=backend))
        assert rates.color.shape == (8, 18, 20, 3) and not rates.color.any() and not rates.alpha.any()


def test_what_cannot_be_done_is_refused() -> None:
    for count in (0, 9):
        with pytest.raises(RtgsError, match=rf"{count} directions.*8"):
            render_with_tangents(cloud(3), pinhole(20, 20), POSE, [Direction()] * count)
    with pytest.raises(RtgsError, match="undistort"):
        render_with_tangents(cloud(3), replace(pinhole(20, 20), model="OPENCV"), POSE, [Direction()])
    with pytest.raises(RtgsError, match=r"9 channels.*8"):
        render_with_tangents(cloud(3, 1, 9), pinhole(20, 20), POSE, [Direction()])


def test_cpu_takes_the_place_of_cuda_which_has_no_forward_mode() -> None:
    model, camera = cloud(40, 1, 3), pinhole(37, 21)
    backends: tuple[Backend, ...] = ("cuda", "cpu")
    asked, done = (
        render_with_tangents(model, camera, POSE, EVERY_WAY[:2], settings=RenderSettings(backend=backend)) for backend in backends
    )
    assert torch.equal(asked[0].color, done[0].color) and torch.equal(asked[1].color, done[1].color)
    assert done[1].color.abs().max() > 0.1
