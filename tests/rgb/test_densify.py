"""A round of densification, and the budget."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest
import torch

from rtgs.config import DensifyConfig
from rtgs.maths.adam import Adam
from rtgs.maths.quaternions import rotations_from_quats
from rtgs.rgb.densify import ScreenGradients, budget, densify, is_round, target_count


def trained() -> Adam:
    """Eight Gaussians after one step of Adam: 5 is faint, 6 larger than the scene, 7 not finite, 2 larger than a hundredth."""
    g = torch.Generator().manual_seed(0)
    parameters = {
        "means": torch.randn(8, 3, generator=g),
        "quats": torch.randn(8, 4, generator=g),
        "log_scales": torch.full((8, 3), math.log(0.001)),
        "opacity_logits": torch.zeros(8),
        "sh": torch.randn(8, 1, 3, generator=g),
    }
    optimizer = Adam(parameters, dict.fromkeys(parameters, 1e-3))
    torch.stack([(v * torch.randn(v.shape, generator=g)).sum() for v in optimizer.parameters.values()]).sum().backward()
    optimizer.step()
    with torch.no_grad():
        optimizer.parameters["log_scales"][2] = torch.tensor([0.1, 0.02, 0.001]).log()
        optimizer.parameters["opacity_logits"][5] = -8.0
        optimizer.parameters["log_scales"][6] = math.log(1.5)
        optimizer.parameters["means"][7, 1] = float("nan")
    return optimizer


def grow(target: int, wanted: list[float], seed: int = 0) -> tuple[Adam, int]:
    optimizer = trained()
    gradients = ScreenGradients(8)
    gradients.total = torch.tensor(wanted)
    gradients.count = torch.ones(8)
    n = densify(
        optimizer,
        gradients,
        DensifyConfig(),
        target=target,
        extent=1.0,
        generator=torch.Generator().manual_seed(seed),
    )
    return optimizer, n


WANTED = [1.0, 5.0, 4.0, 0.0, 2.0, 9.0, 9.0, 9.0]


@pytest.mark.parametrize(
    ("target", "sources"),
    [
        (0, [0, 1, 2, 3, 4]),  # over the target: pruned, none added
        (5, [0, 1, 2, 3, 4]),
        (6, [0, 1, 2, 3, 4, 1]),  # 1 is cloned
        (7, [0, 1, 3, 4, 1, 2, 2]),  # and 2 split
        (9, [0, 1, 3, 4, 1, 4, 0, 2, 2]),
        (100, [0, 1, 3, 4, 1, 4, 0, 2, 2]),  # 3 has no gradient
    ],
)
def test_a_round_prunes_clones_and_splits(target: int, sources: list[int]) -> None:
    before = trained().parameters
    optimizer, n = grow(target, WANTED)
    parameters = optimizer.parameters
    assert n == len(sources) and all(len(v) == n for v in parameters.values())
    for name in ("quats", "opacity_logits", "sh"):
        assert torch.equal(parameters[name], before[name][sources]), name
    whole = torch.tensor([s != 2 or 2 not in sources[-2:] for s in sources])
    index = torch.tensor(sources)
    for name in ("means", "log_scales"):
        assert torch.equal(parameters[name][whole], before[name][index[whole]]), name
    if not whole.all():  # the halves: 1.6 times smaller, drawn from their parent
        assert torch.allclose(parameters["log_scales"][~whole], before["log_scales"][2] - math.log(1.6))
        offsets = parameters["means"][~whole] - before["means"][2]
        assert offsets[0].norm() > 0 and not torch.equal(offsets[0], offsets[1])


def test_halves_are_samples_of_their_parent() -> None:
    # In the parent's own axes and sizes the offsets are standard normal.
    before = trained().parameters
    rotation = rotations_from_quats(before["quats"][2:3])[0]
    offsets = torch.stack(
        [grow(7, WANTED, seed)[0].parameters["means"][-2:] - before["means"][2] for seed in range(150)]
    ).reshape(-1, 3)
    standard = (offsets @ rotation) / before["log_scales"][2].exp()
    assert standard.mean(0).abs().max() < 0.25  # 300 samples: four standard errors
    assert (standard.std(0) - 1).abs().max() < 0.17


def test_moments_are_carried_over_and_those_of_new_gaussians_are_zero() -> None:
    old, (optimizer, _) = trained(), grow(7, WANTED)
    assert optimizer.steps == 1
    for name, parameter in optimizer.parameters.items():
        for moments, before in ((optimizer.first, old.first), (optimizer.second, old.second)):
            assert before[name].any() and torch.equal(moments[name][:4], before[name][[0, 1, 3, 4]])
            assert moments[name].shape == parameter.shape and not moments[name][4:].any()
    was = {name: parameter.detach().clone() for name, parameter in optimizer.parameters.items()}
    torch.stack([v.sum() for v in optimizer.parameters.values()]).sum().backward()
    optimizer.step()  # the optimiser works on what is there now
    assert not any(torch.equal(parameter, was[name]) for name, parameter in optimizer.parameters.items())


def test_screen_gradients_are_the_mean_over_visible_views() -> None:
    gradients = ScreenGradients(3)
    gradients.add(torch.tensor([[3.0, 0.0], [0.0, 0.0], [0.1, 0.0]]), torch.tensor([True, True, False]), 20, 40)
    gradients.add(torch.tensor([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]), torch.tensor([True, False, False]), 20, 40)
    # Half the image: 3 · 10 = 30 along x, 1 · 20 = 20 along y.
    torch.testing.assert_close(gradients.mean(), torch.tensor([25.0, 0.0, 1.0]))


def test_the_schedule_reaches_the_budget_and_no_further() -> None:
    config = DensifyConfig(every=10, start=0.1, stop=0.5)
    counts = [target_count(config, 100, 1000, step, 1000) for step in range(0, 1001, 10)]
    assert counts[10] == 100 and counts[50] == 1000 and counts[-1] == 1000
    assert all(a <= b for a, b in itertools.pairwise(counts))
    assert target_count(config, 5000, 1000, 300, 1000) == 5000  # more points than the budget: the caller's choice
    assert [s for s in range(1001) if is_round(config, s, 1000)] == list(range(100, 501, 10))


def test_the_budget_follows_the_picture_unless_it_is_given() -> None:
    assert budget(DensifyConfig(max_gaussians=77), 1_000_000, 500) == 77
    four = DensifyConfig(pixels_each=4.0)
    assert budget(four, 960 * 540, 500) == 129_600
    assert budget(replace(four, pixels_each=8.0), 960 * 540, 500) == 64_800
    assert budget(four, 100 * 100, 500) == 10_000
    assert budget(four, 100 * 100, 30_000) == 30_000
    assert budget(four, 4000 * 3000, 500) == 150_000
