"""The renderer's milliseconds: a random cloud of 100,000 Gaussians with SH of degree 3, as NeRF-Synthetic's camera sees it.

    python benchmarks/render.py [--sizes 400 800 --gaussians 100000 --threads 1 --repeats 7]
        [--reference-size 64 --reference-gaussians 2000] [--rival FOLDER]

Prints a Markdown table of medians, the difference and the ratio to the PyTorch reference on a smaller case (at full size it would
take minutes and gigabytes), and peak memory. `--rival` names a folder with a `torch_rival.py` whose
`render(means, quats, scales, opacities, sh, camera_from_world, K, width, height)` draws the scene with gsplat's PyTorch functions.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import resource
import statistics
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import numba
import numpy as np
import torch
from torch import Tensor

from rtgs import __version__
from rtgs.camera import Camera
from rtgs.gaussians import Gaussians
from rtgs.geometry import SE3
from rtgs.image import GRAY_WEIGHTS
from rtgs.render import Backend, RenderSettings, render
from rtgs.sh import C0

FIELD_OF_VIEW_RAD = 0.6911112  # NeRF-Synthetic's


def random_cloud(n: int, seed: int = 0) -> Gaussians:
    """Uniform in a cube of side 1.2: a centimetre across in the median, of any shape and opacity."""
    rng = np.random.default_rng(seed)
    means = rng.uniform(-0.6, 0.6, (n, 3))
    log_scales = rng.normal(math.log(0.01), 0.5, (n, 1)) + rng.normal(0, 0.4, (n, 3))
    quats = rng.normal(size=(n, 4))
    opacities = rng.uniform(0.1, 0.95, n)
    sh = np.concatenate([(rng.uniform(0, 1, (n, 1, 3)) - 0.5) / C0, rng.normal(0, 0.08, (n, 15, 3))], axis=1)
    arrays = (means, quats, log_scales, np.log(opacities / (1 - opacities)), sh)
    return Gaussians(*(torch.tensor(a, dtype=torch.float32) for a in arrays))


def view(size: int) -> tuple[Camera, SE3]:
    """A square picture from 2.6 units away, looking at the middle; y is up."""
    focal = 0.5 * size / math.tan(0.5 * FIELD_OF_VIEW_RAD)
    eye = np.array([1.2, 0.9, 1.8])
    eye *= 2.6 / np.linalg.norm(eye)
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Camera("PINHOLE", size, size, focal, focal, size / 2, size / 2), SE3(rotation, -rotation @ eye)


def median_ms(function: Callable[[], object], repeats: int) -> float:
    function()  # compiles, or reads the compiled code
    samples = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        samples.append(1e3 * (time.perf_counter() - start))
    return statistics.median(samples)


def picture(model: Gaussians, size: int, backend: Backend, channel_weights: tuple[float, ...] | None = None) -> Tensor:
    camera, camera_from_world = view(size)
    settings = RenderSettings(backend=backend, channel_weights=channel_weights)
    return render(model, camera, camera_from_world, settings=settings).color


def backward_of(model: Gaussians, size: int, backend: Backend, fields: tuple[str, ...]) -> Callable[[], None]:
    """Forward and backward, with gradients for `fields` of the model."""
    leaves = {k: v.clone().requires_grad_(k in fields) for k, v in model.tensors().items()}
    weights = torch.randn(size, size, 3, generator=torch.Generator().manual_seed(7))

    def run() -> None:
        for leaf in leaves.values():
            leaf.grad = None
        (picture(Gaussians(**leaves), size, backend) * weights).sum().backward()

    return run


@torch.no_grad()
def forward(model: Gaussians, size: int, backend: Backend, channel_weights: tuple[float, ...] | None = None) -> Tensor:
    return picture(model, size, backend, channel_weights)


ALL_FIELDS = ("means", "quats", "log_scales", "opacity_logits", "sh")


def timings(model: Gaussians, size: int, backend: Backend, repeats: int) -> dict[str, float]:
    return {
        "forward": median_ms(lambda: forward(model, size, backend), repeats),
        "forward, gray": median_ms(lambda: forward(model, size, backend, GRAY_WEIGHTS), repeats),
        "forward and backward": median_ms(backward_of(model, size, backend, ALL_FIELDS), repeats),
        "forward and backward, colours only": median_ms(backward_of(model, size, backend, ("sh",)), repeats),
    }


def rival_timings(folder: Path, model: Gaussians, size: int, repeats: int, threads: int) -> tuple[dict[str, float], Tensor]:
    sys.path.insert(0, str(folder.resolve()))
    rival = import_module("torch_rival").render
    torch.set_num_threads(threads)  # its import sets one
    camera, pose = view(size)
    matrix = torch.tensor(pose.matrix(), dtype=torch.float32)
    intrinsics = torch.tensor(camera.matrix, dtype=torch.float32)
    leaves = [x.clone().requires_grad_() for x in (model.means, model.quats, model.log_scales, model.opacity_logits, model.sh)]
    weights = torch.randn(size, size, 3, generator=torch.Generator().manual_seed(7))

    def run() -> Tensor:
        means, quats, log_scales, logits, sh = leaves
        image: Tensor = rival(means, quats, log_scales.exp(), logits.sigmoid(), sh, matrix, intrinsics, size, size)[..., :3]
        return image

    def run_backward() -> None:
        for leaf in leaves:
            leaf.grad = None
        (run() * weights).sum().backward()

    with torch.no_grad():
        image, ms = run(), median_ms(run, repeats)
    return {"forward": ms, "forward and backward": median_ms(run_backward, repeats)}, image


def peak_mib() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if sys.platform == "darwin" else peak / 2**10


def print_table(columns: dict[str, dict[str, float]]) -> None:
    rows = list(dict.fromkeys(row for column in columns.values() for row in column))
    print("| ms | " + " | ".join(columns) + " |\n|---|" + "---:|" * len(columns))
    for row in rows:
        cells = [f"{column[row]:,.1f}" if row in column else "–" for column in columns.values()]
        print(f"| {row} | " + " | ".join(cells) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[400, 800])
    parser.add_argument("--gaussians", type=int, default=100_000)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--reference-size", type=int, default=64, help="picture of the comparison with the reference; 0: none")
    parser.add_argument("--reference-gaussians", type=int, default=2_000)
    parser.add_argument("--rival", type=Path, help="folder of torch_rival.py; gsplat has to be installed")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    numba.set_num_threads(args.threads)

    print(
        f"rtgs {__version__}, torch {torch.__version__}, numba {numba.__version__}, Python {platform.python_version()}; "
        f"{args.threads} of {os.cpu_count()} cores, {platform.machine()}; medians of {args.repeats}\n"
    )
    model = random_cloud(args.gaussians)
    columns = {f"{size}²": timings(model, size, "cpu", args.repeats) for size in args.sizes}
    memory = peak_mib()
    print(f"{args.gaussians:,} Gaussians, `cpu` back end; peak memory {memory:,.0f} MiB\n")
    print_table(columns)

    if args.reference_size:
        size, small = args.reference_size, random_cloud(args.reference_gaussians)
        fast, slow = timings(small, size, "cpu", args.repeats), timings(small, size, "reference", min(args.repeats, 3))
        ratio = {row: slow[row] / fast[row] for row in slow}
        double = forward(small.to(torch.float64), size, "reference")
        difference = (forward(small, size, "cpu") - double).abs().max()
        print(f"\n{len(small):,} Gaussians at {size}²; largest difference of the picture to float64 {difference:.1e}\n")
        print_table({"`cpu`": fast, "`reference`": slow, "ratio": ratio})
        print(f"\nPeak memory {peak_mib():,.0f} MiB")

    if args.rival is not None:
        columns = {}
        differences = []
        for size in args.sizes:
            theirs, image = rival_timings(args.rival, model, size, min(args.repeats, 3), args.threads)
            ours = {
                "forward": median_ms(lambda size=size: forward(model, size, "cpu"), args.repeats),
                "forward and backward": median_ms(backward_of(model, size, "cpu", ALL_FIELDS), args.repeats),
            }
            columns |= {
                f"rival {size}²": theirs,
                f"`cpu` {size}²": ours,
                f"ratio {size}²": {k: theirs[k] / ours[k] for k in ours},
            }
            differences.append((forward(model, size, "cpu") - image).abs().max().item())
        print(f"\nAgainst gsplat's PyTorch functions; largest difference of the pictures {max(differences):.1e}\n")
        print_table(columns)


if __name__ == "__main__":
    main()
