"""The defaults of the scale's search beside other choices, on a capture whose truth nobody knows.

    python benchmarks/scale_ablation.py RUN [--splits 2]

RUN is a run folder with an RGB model. Every choice of `rtgs experiment synthetic --table ablation` finds the scale from all training
frames, and from random disjoint halves of them. The further two halves are apart, the more of the answer is chance. What all frames
have wrong alike does not show here; that is what the synthetic table is for.

Prints a Markdown table.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from rtgs.experiments.ablation import ABLATION
from rtgs.experiments.rivals import OURS
from rtgs.run.folder import RunFolder
from scale_splits import halves, in_words, seen_by


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--splits", type=int, default=2, help="pairs of halves")
    o = parser.parse_args()
    folder = RunFolder(o.run)
    scene, model = folder.load_scene(), folder.read_rgb()
    train, first = scene.train_frames, None
    print("| changed | SfM units per metre | from the default, % | halves apart, % |\n|---|---:|---:|---:|")
    for method in (OURS, *ABLATION):
        whole = method(scene, model)
        first = first or whole
        apart = []
        for split in range(o.splits):
            one, other = (method(seen_by(scene, half), model).sfm_per_metre for half in halves(train, split))
            apart.append(f"{100 * abs(math.log(one / other)):.2f}")
        print(
            f"| {'nothing' if method is OURS else method.title} | {in_words(whole)} "
            f"| {100 * (whole.sfm_per_metre / first.sfm_per_metre - 1):+.2f} | {', '.join(apart)} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
