"""Fused SSIM against two torch conv2d SSIMs in the same run, one thread unless told otherwise: the separable `reference_ssim`,
and the full 11 × 11 window that 3DGS-style training code uses.

    python benchmarks/ssim.py [--width 960 --height 540 --channels 3 --threads 1 --repeats 10]

Prints a Markdown table of milliseconds (median) for value and gradient, and the ratios.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numba
import torch
from torch import Tensor

from rtgs.losses.ssim import C1, C2, reference_ssim, ssim, window_taps


def full_window_ssim(a: Tensor, b: Tensor) -> Tensor:
    taps = torch.as_tensor(window_taps(), dtype=a.dtype)
    channels = a.shape[2]
    window = torch.outer(taps, taps).repeat(channels, 1, 1, 1)

    def blur(x: Tensor) -> Tensor:
        return torch.nn.functional.conv2d(x, window, groups=channels)

    x, y = (i.permute(2, 0, 1)[None].contiguous() for i in (a, b))
    mu_x, mu_y = blur(x), blur(y)
    var_x, var_y, cov = blur(x * x) - mu_x**2, blur(y * y) - mu_y**2, blur(x * y) - mu_x * mu_y
    values = (2 * mu_x * mu_y + C1) * (2 * cov + C2) / ((mu_x**2 + mu_y**2 + C1) * (var_x + var_y + C2))
    return values.mean()


def milliseconds(function: Callable[[Tensor, Tensor], Tensor], a: Tensor, b: Tensor, repeats: int) -> float:
    samples = []
    for _ in range(repeats + 1):
        a.grad = None
        start = time.perf_counter()
        function(a, b).backward()
        samples.append(1e3 * (time.perf_counter() - start))
    return statistics.median(samples[1:])  # the first call compiles


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in {"width": 960, "height": 540, "channels": 3, "threads": 1, "repeats": 10}.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    numba.set_num_threads(args.threads)
    torch.manual_seed(0)
    b = torch.rand(args.height, args.width, args.channels)
    a = (b + 0.1 * torch.randn_like(b)).clamp(0, 1).requires_grad_()
    fused = milliseconds(ssim, a, b, args.repeats)
    separable = milliseconds(reference_ssim, a, b, args.repeats)
    full = milliseconds(full_window_ssim, a, b, args.repeats)
    print(f"{args.width} × {args.height} × {args.channels}, {args.threads} thread(s), value and gradient\n")
    print("| | ms | times fused |\n|---|---:|---:|")
    for name, value in (("fused", fused), ("torch, separable", separable), ("torch, 11 × 11 window", full)):
        print(f"| {name} | {value:.1f} | {value / fused:.1f} |")


if __name__ == "__main__":
    main()
