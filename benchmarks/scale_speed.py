"""How long the search takes beside the paper's 200 full-batch Adam steps, on the same frames, model and renderer.

    python benchmarks/scale_speed.py RUN [--repeats 3]

RUN is a run folder with an RGB model. A step of Adam needs a loss and a slope of every frame: "forward" takes the slope from a tangent
picture, as `--scale.solver adam` does, "reverse" through the renderer's backward pass, as the paper does. A few
of their 200 steps are timed, since all cost alike. Prints a Markdown table of medians.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from reverse_mode import loss_and_slope_in_reverse
from rtgs.config import ScaleConfig
from rtgs.losses.edge_loss import EdgeLoss
from rtgs.run.folder import RunFolder
from rtgs.scale import Objective, estimate_scale
from rtgs.scale.adam import descend_by_adam

STEPS, TIMED = 200, 3


def seconds(work: Callable[[], object], repeats: int) -> float:
    work()  # compiles, prepares targets
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return float(np.median(times))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--repeats", type=int, default=3)
    o = parser.parse_args()
    folder = RunFolder(o.run)
    scene, model = folder.load_scene(), folder.read_rgb()
    frames = scene.train_frames
    objective = Objective(scene, model, frames, EdgeLoss())
    found = estimate_scale(scene, model)
    theta = math.log(1.1 * found.sfm_per_metre)
    ours = seconds(lambda: estimate_scale(scene, model), o.repeats)
    forward = (
        seconds(lambda: descend_by_adam(objective, theta, ScaleConfig(solver="adam", steps=TIMED)), o.repeats) * STEPS / TIMED
    )
    few = range(min(5, len(frames)))
    reverse = seconds(lambda: [loss_and_slope_in_reverse(objective, i, theta) for i in few], o.repeats)
    reverse *= STEPS * len(frames) / len(few)
    camera = scene.rig.thermal
    print(f"{len(frames)} frames of {camera.width}×{camera.height}, {len(model.gaussians):,} Gaussians.\n")
    print("| | seconds | times ours |\n|---|---:|---:|")
    for name, value in (("ours", ours), ("Adam, forward mode", forward), ("Adam, reverse mode", reverse)):
        print(f"| {name} | {value:.1f} | {value / ours:.1f} |")


if __name__ == "__main__":
    main()
