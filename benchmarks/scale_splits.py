"""Does one half of a real capture say the same as the other? Random disjoint halves of the training frames, each with its interval.

    python benchmarks/scale_splits.py RUN [--splits 5] [--refine rotation baseline-direction focal]

RUN is a run folder with an RGB model. Two halves agree when their answers differ by less than their intervals allow together:
|ln s₁ − ln s₂| ≤ √(h₁² + h₂²), h half of `ci95` in ln s; whether the intervals overlap is said beside it. The RGB model has seen all
training frames; the halves are of the frames that the scale is taken from.

Prints a Markdown table.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rtgs.config import ScaleConfig
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.run.folder import RunFolder
from rtgs.scale import ScaleEstimate, estimate_scale


def seen_by(scene: Scene, frames: Sequence[Frame]) -> Scene:
    return replace(scene, world_from_rgb={f.name: scene.world_from_rgb[f.name] for f in frames})


def halves(frames: Sequence[Frame], split: int) -> tuple[list[Frame], list[Frame]]:
    """Two random disjoint halves, each in the frames' order."""
    order = np.random.default_rng(split).permutation(len(frames))
    first, second = sorted(order[: len(frames) // 2]), sorted(order[len(frames) // 2 :])
    return [frames[i] for i in first], [frames[i] for i in second]


def half_width(estimate: ScaleEstimate) -> float:
    """Of `ci95` in ln s; infinite where there is none."""
    return 0.5 * math.log(estimate.ci95[1] / estimate.ci95[0]) if estimate.ci95 else math.inf


def in_words(estimate: ScaleEstimate) -> str:
    return f"{estimate.sfm_per_metre:.5g} ± {100 * half_width(estimate):.2f} %" + (
        "" if estimate.status == "ok" else f" ({estimate.status})"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--splits", type=int, default=5)
    parser.add_argument("--refine", nargs="*", default=[])
    o = parser.parse_args()
    folder = RunFolder(o.run)
    scene, model = folder.load_scene(), folder.read_rgb()
    settings = ScaleConfig(refine=tuple(o.refine))
    train = scene.train_frames
    print(f"All {len(train)} training frames: {in_words(estimate_scale(scene, model, settings))}.\n", flush=True)
    print("| split | one half | the other | apart | allowed | agree | intervals overlap |\n|---|---|---|---|---|---|---|")
    for split in range(o.splits):
        one, other = (estimate_scale(seen_by(scene, half), model, settings) for half in halves(train, split))
        apart = abs(math.log(one.sfm_per_metre / other.sfm_per_metre))
        allowed, together = math.hypot(half_width(one), half_width(other)), half_width(one) + half_width(other)
        print(
            f"| {split} | {in_words(one)} | {in_words(other)} | {100 * apart:.2f} % | {100 * allowed:.2f} % | "
            f"{'yes' if apart <= allowed else 'no'} | {'yes' if apart <= together else 'no'} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
