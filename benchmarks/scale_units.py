"""Does the unit of structure from motion matter? One capture with its poses in units ten thousand times smaller and larger.

    python benchmarks/scale_units.py --out DIR [--scene lego] [--size 200] [--frames 32]

Each capture is triangulated, trained and searched from scratch. Prints a Markdown table of the metres that come out: the baseline's length
in SfM units over `sfm_per_metre`, so to say, which should not change.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from rtgs.config import RgbConfig, SynthConfig
from rtgs.experiments.trials import Trial, prepare
from rtgs.scale import estimate_scale

UNITS = (1.0, 1e-4, 1e4)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--scene", default="lego")
    parser.add_argument("--size", type=int, default=200)
    parser.add_argument("--frames", type=int, default=32)
    o = parser.parse_args()
    base = SynthConfig(scene=o.scene, frames=o.frames, size=o.size, thermal_clean=False)
    print("| SfM units in a metre | found | over the truth | against the first |\n|---|---|---|---|")
    first = None
    for unit in UNITS:
        config = replace(base, sfm_per_metre=unit)
        folder = o.out / f"{o.scene}_{unit:g}"
        prepare(folder, config, RgbConfig(quality="fast"))
        trial = Trial.read(folder, config, 0)
        scene = trial.base
        found = estimate_scale(scene, trial.model)
        ratio = found.sfm_per_metre / unit
        first = first or ratio
        print(
            f"| {unit:g} | {found.sfm_per_metre:.6g} ({found.status}) | {ratio:.5f} | {100 * (ratio / first - 1):+.3f} % |",
            flush=True,
        )


if __name__ == "__main__":
    main()
