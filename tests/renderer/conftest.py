"""Back ends as fixtures: a test that takes one runs with each of them."""

from __future__ import annotations

import sys
from types import ModuleType

import pytest
import torch

from rtgs.config import Backend
from rtgs.renderer import cuda

CUDA = [
    "cuda in PyTorch",
    pytest.param("cuda on a GPU", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no CUDA GPU")),
]

UNPREPARED: dict[str, Backend] = {"cpu": "cpu", "reference": "reference"}
"""Back ends that need no preparation."""


def prepared(name: str, monkeypatch: pytest.MonkeyPatch) -> Backend:
    """The back end's name in `RenderSettings`; "cuda in PyTorch" has gsplat's kernels replaced (see `gsplat_kernels`)."""
    if name in UNPREPARED:
        return UNPREPARED[name]
    pytest.importorskip("gsplat", reason="gsplat is not installed")
    if name == "cuda in PyTorch":
        from tests.helpers.gsplat_kernels import Kernels

        backend = ModuleType("gsplat.cuda._backend")
        backend._C = Kernels  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", backend)
        monkeypatch.setattr(cuda, "device", lambda: torch.device("cpu"))
    return "cuda"


@pytest.fixture(params=["cpu", "reference", *CUDA])
def backend(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Backend:
    """Every back end."""
    return prepared(request.param, monkeypatch)


@pytest.fixture(params=["cpu", *CUDA])
def compiled(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Backend:
    """The back ends that are held against the reference."""
    return prepared(request.param, monkeypatch)


@pytest.fixture(params=CUDA)
def cuda_kernels(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The "cuda" back end."""
    prepared(request.param, monkeypatch)
