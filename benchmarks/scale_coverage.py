"""Does the interval hold the truth as often as it says? Trials whose noise, rig and calibration errors are drawn from what is stated.

    python benchmarks/scale_coverage.py --out DIR [--size 200] [--frames 32] [--views 4] [--trials 5] [--workers 2]

Each of the six object scenes is photographed along `--views` camera paths, which makes as many RGB models, and each of these is seen by
`--trials` rigs, drawn with their noise. The rig that is told differs from the true one by errors drawn from the normal distributions whose
standard deviations it also tells (`uncertainty` in rig.json). Reported: how often `ci95` holds the truth, and the same for exact
calibration, where the interval is the frames' scatter alone. What is in DIR already is kept.

Prints a Markdown table and writes `DIR/coverage.csv`.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
import zlib
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, fields, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from rtgs.base.json_records import read_json, write_json
from rtgs.config import SCENES, RgbConfig, SceneName, SynthConfig
from rtgs.experiments.trials import Trial, prepare
from rtgs.experiments.variants import Variant
from rtgs.records.rig import CalibrationStd
from rtgs.records.scene import Scene
from rtgs.scale import estimate_scale

STD = CalibrationStd(baseline_length=0.005, baseline_direction=0.005, rotation_rad=math.radians(0.05), thermal_focal=0.003)


@dataclass(frozen=True)
class Row:
    """One trial: errors and half-widths in % of the scale."""

    scene: str
    view: int
    trial: int
    calibration: str
    error_pct: float
    half_width_pct: float
    calibration_half_width_pct: float
    covered: bool
    status: str
    frames: int


def with_std(scene: Scene, std: CalibrationStd | None) -> Scene:
    return replace(scene, capture=replace(scene.capture, rig=replace(scene.rig, calibration_std=std)))


def drawn_errors(rng: np.random.Generator) -> dict[str, float]:
    """Errors of `STD`'s distributions; a direction across the baseline has two components, a rotation three."""
    return {
        "rig_length_error": float(rng.normal(0, STD.baseline_length)),
        "rig_direction_error": float(np.linalg.norm(rng.normal(0, STD.baseline_direction, 2))),
        "rig_rotation_error_deg": math.degrees(float(np.linalg.norm(rng.normal(0, STD.rotation_rad, 3)))),
        "thermal_focal_error": float(rng.normal(0, STD.thermal_focal)),
    }


def run_view(folder: Path, config: SynthConfig, trials: int) -> list[Row]:
    """All trials of one RGB model."""
    import numba
    import torch

    numba.set_num_threads(1)
    torch.set_num_threads(1)
    done = folder / "coverage.json"
    rows = [Row(**r) for r in read_json(done)] if done.exists() else []
    if len(rows) >= 2 * trials:
        return rows[: 2 * trials]
    prepare(folder, config, RgbConfig(quality="fast"))
    for k in range(len(rows) // 2, trials):
        trial = Trial.read(folder, config, k)
        clean = trial.temperatures(None)
        rng = np.random.default_rng([config.seed, k, zlib.crc32(config.scene.encode())])
        for name, variant, std in (
            ("exact", Variant("exact", "exact"), None),
            ("drawn", Variant("drawn", "drawn", changes=drawn_errors(rng)), STD),
        ):
            estimate = estimate_scale(with_std(trial.scene(variant, clean), std), trial.model)
            lo, hi = estimate.ci95 or (math.nan, math.nan)
            rows.append(
                Row(
                    config.scene,
                    config.seed,
                    k,
                    name,
                    100 * (estimate.sfm_per_metre / trial.truth - 1),
                    50 * math.log(hi / lo),
                    196 * (estimate.calibration_std_log or 0.0),
                    lo <= trial.truth <= hi,
                    estimate.status,
                    len(estimate.frames),
                )
            )
        write_json(done, [asdict(r) for r in rows])
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--size", type=int, default=200)
    parser.add_argument("--frames", type=int, default=32)
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--trials", type=int, default=5)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--scenes", nargs="*", default=SCENES[:6])
    o = parser.parse_args()
    rows: list[Row] = []
    with ProcessPoolExecutor(o.workers, get_context("spawn")) as pool:
        jobs = []
        for view in range(o.views):
            for name in o.scenes:
                scene: SceneName = name
                config = SynthConfig(scene=scene, frames=o.frames, size=o.size, seed=view, thermal_clean=False)
                jobs.append(pool.submit(run_view, o.out / f"{name}.{view}", config, o.trials))
        for count, job in enumerate(as_completed(jobs), 1):
            rows += job.result()
            print(f"\r{count}/{len(jobs)} RGB models ", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    rows.sort(key=lambda r: (r.calibration, r.scene, r.view, r.trial))
    with (o.out / "coverage.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(Row)])
        writer.writeheader()
        writer.writerows(asdict(r) for r in rows)
    print(f"{o.size}×{o.size}, {o.frames} frames, {o.views} camera paths of each scene, {o.trials} rigs each.\n")
    print("| scene | calibration | trials | ci95 holds the truth | median half-width % | median error % | not ok |")
    print("|---|---|---|---|---|---|---|")
    for calibration in ("exact", "drawn"):
        for name in (*o.scenes, "all"):
            some = [r for r in rows if r.calibration == calibration and name in (r.scene, "all")]
            print(
                f"| {name} | {calibration} | {len(some)} | {100 * np.mean([r.covered for r in some]):.0f} % "
                f"| {np.median([r.half_width_pct for r in some]):.2f} | {np.median([abs(r.error_pct) for r in some]):.2f} "
                f"| {sum(r.status != 'ok' for r in some)} |"
            )


if __name__ == "__main__":
    main()
