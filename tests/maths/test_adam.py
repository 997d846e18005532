"""The compiled Adam against torch's, and what a checkpoint and a changing model ask of it."""

from __future__ import annotations

import numba
import pytest
import torch
from torch import Tensor

from rtgs.maths.adam import EPSILON, Adam

SHAPES = {"means": (301, 3), "opacity_logits": (301,), "sh": (301, 16, 3), "background": (3,)}
RATES = {"means": 1e-3, "opacity_logits": 5e-2, "sh": 2.5e-3, "background": 2e-3}


def values(seed: int, scale: float = 1.0) -> dict[str, Tensor]:
    g = torch.Generator().manual_seed(seed)
    return {name: scale * torch.randn(shape, generator=g) for name, shape in SHAPES.items()}


def run(optimizer: Adam, steps: range, scale: float = 1e-4) -> None:
    for step in steps:
        for name, gradient in values(100 + step, scale).items():
            optimizer.parameters[name].grad = gradient
        optimizer.step()


@pytest.mark.parametrize("scale", [1.0, 1e-4, 1e-9])
def test_steps_are_torchs(scale: float) -> None:
    ours = Adam(values(0), RATES)
    theirs = {name: value.double().requires_grad_() for name, value in values(0).items()}
    torchs = torch.optim.Adam([{"params": [theirs[k]], "lr": RATES[k]} for k in SHAPES], eps=EPSILON)
    for step in range(60):
        for name, gradient in values(100 + step, scale).items():
            ours.parameters[name].grad, theirs[name].grad = gradient, gradient.double()
        ours.step()
        torchs.step()
    for name, value in theirs.items():
        moved = (value.detach() - values(0)[name]).abs().max().item()
        assert moved > 5 * RATES[name]
        # Sixty float32 additions to values up to 4 carry 60 · 2.4e-7.
        torch.testing.assert_close(ours.parameters[name].detach().double(), value.detach(), rtol=0, atol=1.5e-5)
        state = torchs.state[value]
        for moment, expected in ((ours.first, state["exp_avg"]), (ours.second, state["exp_avg_sq"])):
            torch.testing.assert_close(moment[name].double(), expected, rtol=1e-5, atol=1e-6 * expected.abs().max().item())


def test_each_column_has_its_rate_and_a_rate_of_zero_moves_nothing() -> None:
    start = torch.zeros(130, 16, 3)
    rates = torch.full((16, 1), 1e-4)
    rates[0] = 1e-2
    rates[5] = 0.0
    optimizer = Adam({"sh": start.clone()}, {"sh": rates})
    optimizer.parameters["sh"].grad = torch.full((130, 16, 3), -3.0)
    optimizer.step()
    # Adam's first step is the rate, whatever the gradient.
    torch.testing.assert_close(optimizer.parameters["sh"].detach(), rates.expand(16, 3).expand(130, 16, 3), rtol=1e-5, atol=0)


def test_a_parameter_without_gradient_stays_and_gradients_are_dropped() -> None:
    optimizer = Adam(values(0), RATES)
    optimizer.parameters["means"].grad = torch.ones(301, 3)
    optimizer.step()
    assert all(p.grad is None for p in optimizer.parameters.values())
    assert torch.equal(optimizer.parameters["sh"].detach(), values(0)["sh"])
    assert not torch.equal(optimizer.parameters["means"].detach(), values(0)["means"])


def test_the_number_of_threads_does_not_matter() -> None:
    results = []
    threads = numba.get_num_threads()
    try:
        most = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]  # Numba sets it from the environment
        for n in sorted({1, min(2, most)}):
            numba.set_num_threads(n)
            optimizer = Adam(values(0), RATES)
            run(optimizer, range(5))
            results.append(optimizer.state())
    finally:
        numba.set_num_threads(threads)
    for name in SHAPES:
        assert torch.equal(results[0]["parameters"][name], results[-1]["parameters"][name])


def test_a_restored_state_goes_on_bit_for_bit() -> None:
    whole = Adam(values(0), RATES)
    run(whole, range(20))
    half = Adam(values(0), RATES)
    run(half, range(9))
    # A checkpoint is written and read; here a copy stands for it.
    saved = {k: v if isinstance(v, int) else {n: t.clone() for n, t in v.items()} for k, v in half.state().items()}
    run(half, range(9, 12))
    resumed = Adam(values(7), RATES)
    resumed.restore(saved)
    run(resumed, range(9, 20))
    assert resumed.steps == 20
    for name in SHAPES:
        assert torch.equal(whole.parameters[name], resumed.parameters[name])
        assert torch.equal(whole.first[name], resumed.first[name]) and torch.equal(whole.second[name], resumed.second[name])


def test_a_replaced_parameter_may_have_another_size() -> None:
    optimizer = Adam(values(0), RATES)
    run(optimizer, range(3))
    index = torch.tensor([5, 5, 300, 0])
    tensors = (optimizer.parameters["sh"], optimizer.first["sh"], optimizer.second["sh"])
    alone = Adam({"sh": tensors[0].detach()[index]}, RATES)
    alone.restore(
        {"steps": 3, **{k: {"sh": t.detach()[index]} for k, t in zip(("parameters", "first", "second"), tensors, strict=True)}}
    )
    optimizer.replace("sh", *(t[index] for t in tensors))
    gradient = torch.randn(4, 16, 3, generator=torch.Generator().manual_seed(1))
    for o in (optimizer, alone):
        o.parameters["sh"].grad = gradient.clone()
        o.step()
    assert torch.equal(optimizer.parameters["sh"], alone.parameters["sh"])


def test_what_is_not_a_number_stays_visible() -> None:
    optimizer = Adam({"means": torch.zeros(40, 3)}, {"means": 1e-3})
    gradient = torch.ones(40, 3)
    gradient[7, 1], gradient[9, 2] = float("nan"), float("inf")
    optimizer.parameters["means"].grad = gradient
    optimizer.step()
    bad = ~torch.isfinite(optimizer.parameters["means"].detach())
    assert bad[7, 1] and bad[9, 2] and bad.sum() == 2
