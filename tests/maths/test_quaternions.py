"""Rotations of many Gaussians at once: those of one quaternion after the other, with their gradients."""

from __future__ import annotations

import numpy as np
import torch

from rtgs.maths.geometry import rotation_from_quat
from rtgs.maths.quaternions import rotations_from_quats


def test_they_are_those_of_each_quaternion_alone() -> None:
    quats = np.random.default_rng(0).normal(size=(50, 4)) * 3
    expected = np.stack([rotation_from_quat(q) for q in quats])
    np.testing.assert_allclose(rotations_from_quats(torch.from_numpy(quats)).numpy(), expected, atol=1e-12)


def test_their_gradients_are_those_of_the_formula() -> None:
    quats = torch.from_numpy(np.random.default_rng(1).normal(size=(4, 4))).requires_grad_()
    assert torch.autograd.gradcheck(rotations_from_quats, (quats,))
