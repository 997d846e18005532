"""`render`: whose gradients are computed, repetition and threads, and what is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tests.helpers.compare_renders import all_bits, assert_backends_agree, draw, value_and_gradients
from tests.helpers.gaussian_clouds import POSE, cloud, pinhole
from tests.helpers.gradients import gradient_of

from rtgs.base.errors import RtgsError
from rtgs.config import Backend
from rtgs.maths.geometry import SE3
from rtgs.renderer import RenderSettings, render


def test_gradients_reach_only_what_asks_for_them() -> None:
    model = cloud(40, 1, 3)
    everything = value_and_gradients("cpu", model, pinhole(37, 21), POSE, RenderSettings())[1]
    sh = model.sh.clone().requires_grad_()
    view = render(replace(model, sh=sh), pinhole(37, 21), POSE)
    g = torch.Generator().manual_seed(5)
    parts = [(x.double() * torch.randn(x.shape, generator=g, dtype=torch.float64)).sum() for x in (view.color, view.alpha)]
    torch.stack(parts).sum().backward()  # the colour-only reverse
    torch.testing.assert_close(gradient_of(sh).double(), everything["sh"], rtol=1e-6, atol=1e-9)
    pose = SE3(POSE.rotation.float().requires_grad_(), POSE.translation.float().requires_grad_())
    view = render(model, pinhole(37, 21), pose)
    g = torch.Generator().manual_seed(5)
    parts = [(x.double() * torch.randn(x.shape, generator=g, dtype=torch.float64)).sum() for x in (view.color, view.alpha)]
    torch.stack(parts).sum().backward()
    torch.testing.assert_close(gradient_of(pose.rotation).double(), everything["rotation"], rtol=1e-6, atol=1e-6)
    torch.testing.assert_close(gradient_of(pose.translation).double(), everything["translation"], rtol=1e-6, atol=1e-6)


def test_repetition_is_bit_identical() -> None:
    for a, b in zip(all_bits(cloud(500)), all_bits(cloud(500)), strict=True):
        assert torch.equal(a, b)


@pytest.mark.thorough
def test_the_number_of_threads_is_invisible() -> None:
    # Numba takes its number of threads when it starts, and this process may have one: a process of its own with four.
    program = """
import sys, numba, torch
sys.path.insert(0, sys.argv[1])
from tests.helpers.compare_renders import all_bits
from tests.helpers.gaussian_clouds import cloud
results = []
for threads in (1, 2, 3, 4):
    numba.set_num_threads(threads)
    results.append(all_bits(cloud(500)))
assert all(torch.equal(a, b) for other in results[1:] for a, b in zip(results[0], other, strict=True))
print("the same")
"""
    done = subprocess.run(
        [sys.executable, "-c", program, str(Path(__file__).parents[2])],
        env={**os.environ, "NUMBA_NUM_THREADS": "4"},
        capture_output=True,
        text=True,
    )
    assert done.stdout.strip() == "the same", done.stderr


@pytest.mark.parametrize("model", ["OPENCV", "RADIAL", "SIMPLE_RADIAL", "OPENCV_FISHEYE"])
def test_a_lens_is_refused(model: str) -> None:
    with pytest.raises(RtgsError, match=f"{model}.*undistort"):
        render(cloud(3), replace(pinhole(20, 20), model=model, k1=0.1), POSE)


def test_bands_the_model_does_not_have_are_refused() -> None:
    with pytest.raises(RtgsError, match="sh_degree 2 asked, the model has 1"):
        render(cloud(3, 1), pinhole(20, 20), POSE, settings=RenderSettings(sh_degree=2))


def test_up_to_eight_channels_are_drawn_and_more_refused() -> None:
    assert_backends_agree(cloud(40, 1, 8), pinhole(37, 21), RenderSettings())
    assert_backends_agree(cloud(40, 1, 2), pinhole(37, 21), RenderSettings())
    with pytest.raises(RtgsError, match=r"9 channels.*8"):
        render(cloud(3, 1, 9), pinhole(20, 20), POSE)
    with pytest.raises(RtgsError, match=r"9 channels.*8"):
        render(cloud(3, 1, 8), pinhole(20, 20), POSE, settings=RenderSettings(with_depth=True))
    assert draw(cloud(3, 1, 6), pinhole(20, 20), POSE, "reference").color.shape == (20, 20, 6)


def test_channel_weights_of_another_length_are_refused(backend: Backend) -> None:
    with pytest.raises(RtgsError, match=r"channel_weights.*3.*1"):
        draw(cloud(3, 1, 1), pinhole(20, 20), POSE, backend, channel_weights=(0.3, 0.6, 0.1))
