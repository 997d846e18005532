"""Splitting a Gaussian into two leaves what it is as a whole."""

from __future__ import annotations

from dataclasses import replace

import torch
from tests.helpers.gaussian_clouds import shell

from rtgs.maths.geometry import SE3
from rtgs.maths.quaternions import rotations_from_quats
from rtgs.models import RgbModel
from rtgs.records.camera import Camera
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import RenderSettings
from rtgs.thermal.splitting import split


def some(count: int = 40) -> Gaussians:
    generator = torch.Generator().manual_seed(2)
    cloud = shell(count, generator, size=0.13, spread=0.2, coefficients=4)
    turned = torch.randn(count, 4, generator=generator)
    stretched = cloud.log_scales + 0.5 * torch.randn(count, 3, generator=generator)
    return replace(cloud, quats=turned, log_scales=stretched).to(torch.float64)


def covariances(gaussians: Gaussians) -> torch.Tensor:
    """`[N, 3, 3]`."""
    axes = rotations_from_quats(gaussians.quats) * gaussians.log_scales.exp()[:, None]
    return axes @ axes.mT


def test_mean_covariance_and_colours_of_a_pair_are_the_parents() -> None:
    before = some()
    which = torch.tensor([3, 17, 39])
    after, parents = split(before, which)
    assert len(after) == len(before) + 3 and parents.tolist()[-6:] == [3, 17, 39] * 2
    for parent in which.tolist():
        pair = torch.nonzero(parents == parent)[:, 0]
        mean = after.means[pair].mean(dim=0)
        away = after.means[pair] - mean
        spread = covariances(after)[pair].mean(dim=0) + away.T @ away / 2
        torch.testing.assert_close(mean, before.means[parent])
        torch.testing.assert_close(spread, covariances(before)[parent])
        assert torch.equal(after.sh[pair], before.sh[[parent, parent]])


def test_a_pair_is_smaller_along_the_longest_axis_alone() -> None:
    before = some()
    after, parents = split(before, torch.arange(40))
    ratio = (after.log_scales - before.log_scales[parents]).exp()
    longest = before.log_scales[parents].argmax(dim=1)
    assert (ratio.gather(1, longest[:, None]) < 0.55).all()
    assert torch.allclose(ratio.sum(dim=1), 2 + ratio.amin(dim=1))


def test_what_is_not_split_stays() -> None:
    before = some()
    after, parents = split(before, torch.tensor([5]))
    kept = parents[:-2]
    assert sorted(kept.tolist()) == [n for n in range(40) if n != 5]
    for name, value in before.tensors().items():
        assert torch.equal(after.tensors()[name][:-2], value[kept])
    nothing, same = split(before, torch.tensor([], dtype=torch.int64))
    assert torch.equal(nothing.means, before.means) and same.tolist() == list(range(40))


def test_the_picture_of_a_wide_one_stays() -> None:
    """At any opacity as well as two halves can: the root mean square of what changes is below two fifths of the picture's."""
    camera = Camera("PINHOLE", 64, 48, 60.0, 60.0, 32.0, 24.0)
    for opacity in (0.1, 0.5, 0.9, 0.99):
        one = Gaussians(
            torch.tensor([[0.0, 0.0, 2.0]]),
            torch.tensor([[1.0, 0.0, 0.0, 0.4]]),
            torch.tensor([[0.25, 0.1, 0.01]]).log(),
            torch.logit(torch.tensor([opacity])),
            torch.full((1, 1, 3), 0.7),
        )
        pictures = []
        for gaussians in (one, split(one, torch.tensor([0]))[0]):
            model = RgbModel(gaussians, torch.zeros(3), RenderSettings())
            pictures.append(torch.from_numpy(model.render(camera, SE3.identity())))
        a, b = pictures
        assert float((a - b).square().sum().sqrt() / a.square().sum().sqrt()) < 0.4
