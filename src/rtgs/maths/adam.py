"""Adam in one compiled pass: parameter, gradient and both moments are read and written once.

Kingma & Ba, "Adam: A Method for Stochastic Optimization" (2015), Algorithm 1, as `torch.optim.Adam` has it:

    m ← β1 m + (1 − β1) g,   v ← β2 v + (1 − β2) g²,   p ← p − rate · m / (1 − β1ᵗ) / (√(v / (1 − β2ᵗ)) + ε)

Every element of a parameter is updated, seen or not. Leaving out the Gaussians that a view does not show (selective Adam, Mallick et
al. 2024) was slower here: the pass is bound by memory, and rows picked from all over it take longer than all of them in turn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numba import prange
from torch import Tensor

from rtgs.base.compiled import kernel

BETA_1, BETA_2 = 0.9, 0.999
EPSILON = 1e-15  # 3DGS's: gradients per pixel are far below the customary 1e-8


class Adam:
    """Adam over named parameters.

    Attributes:
        parameters: name → float32 leaf tensor `[N, ...]`. `replace` puts another in its place.
        rates: name → learning rate: a number, or a tensor that broadcasts against a row `[...]`. May be changed between steps.
        steps: how many were made.
        first, second: name → the moments m and v, `[N, ...]`.
    """

    def __init__(self, parameters: Mapping[str, Tensor], rates: Mapping[str, float | Tensor]) -> None:
        self.parameters: dict[str, Tensor] = {}
        self.first: dict[str, Tensor] = {}
        self.second: dict[str, Tensor] = {}
        self.rates = dict(rates)
        self.steps = 0
        for name, value in parameters.items():
            self.replace(name, value, torch.zeros_like(value), torch.zeros_like(value))

    def replace(self, name: str, value: Tensor, first: Tensor, second: Tensor) -> None:
        """Put another tensor, of any N, in a parameter's place, with its moments."""
        self.parameters[name] = value.detach().contiguous().requires_grad_()
        self.first[name], self.second[name] = first.detach().contiguous(), second.detach().contiguous()

    def step(self) -> None:
        """Update every parameter that has a gradient, and drop the gradients."""
        self.steps += 1
        first, second = 1.0 - BETA_1**self.steps, 1.0 - BETA_2**self.steps
        for name, parameter in self.parameters.items():
            if parameter.grad is None:
                continue
            rate = torch.as_tensor(self.rates[name], dtype=torch.float64).broadcast_to(parameter.shape[1:]).reshape(-1)
            # A block is a whole number of rows, so one block's step sizes are every block's.
            step_sizes = (rate / first).to(torch.float32).repeat(_BLOCK_ROWS).numpy()
            p, g = parameter.detach().view(-1).numpy(), parameter.grad.contiguous().view(-1).numpy()
            m, v = self.first[name].view(-1).numpy(), self.second[name].view(-1).numpy()
            _update(p, g, m, v, step_sizes, np.float32(1.0 / math.sqrt(second)))
            parameter.grad = None

    def state(self) -> dict[str, Any]:
        """Parameters, moments and the count: what `restore` goes on from, bit for bit. The tensors are the live ones."""
        values = {name: value.detach() for name, value in self.parameters.items()}
        return {"steps": self.steps, "parameters": values, "first": self.first, "second": self.second}

    def restore(self, state: Mapping[str, Any]) -> None:
        self.steps = state["steps"]
        for name, value in state["parameters"].items():
            self.replace(name, value, state["first"][name], state["second"][name])


_BLOCK_ROWS = 64
_B1, _C1 = np.float32(BETA_1), np.float32(1.0 - BETA_1)
_B2, _C2 = np.float32(BETA_2), np.float32(1.0 - BETA_2)
_EPSILON = np.float32(EPSILON)


@kernel("fast", parallel=True, checks_division=True)
def _update(parameter, gradient, first, second, step_sizes, root):  # type: ignore[no-untyped-def]
    """One step on flat arrays; `step_sizes` repeats with its own length, `root` = 1/√(1 − β2ᵗ)."""
    n, length = len(parameter), len(step_sizes)
    for block in prange((n + length - 1) // length):
        start, stop = block * length, min(n, (block + 1) * length)
        p, g, m, v = parameter[start:stop], gradient[start:stop], first[start:stop], second[start:stop]
        for i in range(stop - start):
            m[i] = _B1 * m[i] + _C1 * g[i]
            v[i] = _B2 * v[i] + _C2 * g[i] * g[i]
            p[i] -= step_sizes[i] * m[i] / (np.sqrt(v[i]) * root + _EPSILON)
