"""Joint refinement on synthetic scenes whose rig file is wrong: the scale's error without and with it, and how honest the posterior is.

    python benchmarks/refine_scale.py --out DIR [--size 400] [--frames 50] [--scenes lego,chair] [--seeds 2]

Each trial is a scene seen by the rig of one seed, the thermal images with that rig's noise. A row makes the rig file wrong, states the
standard deviation of what is refined, and finds the scale by the default solver with the rig as written, then refined from there. Errors
change sign from seed to seed. What DIR holds already is kept (`scenes/`, one RGB model each; `trials.jsonl`). `s·|t|` is compared where the
length is wrong: only that product can be seen.

Prints a Markdown table and what the posterior's standard deviations are worth: the share of true values within two of them. The last column
is the processor's time of the whole scale stage as a multiple of that without refinement; the first trial may compile, so call it twice.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rtgs.config import SCENES, RgbConfig, ScaleConfig, SynthConfig
from rtgs.experiments.trials import Trial, prepare
from rtgs.experiments.variants import Variant
from rtgs.maths.geometry import axis_angle_from_rotation
from rtgs.records.rig import CalibrationStd, Rig
from rtgs.scale import ScaleEstimate, estimate_scale
from rtgs.scale.problem import Problem
from rtgs.scale.refine import refine
from rtgs.scale.rig_motion import motions
from rtgs.synthetic.rig import true_rig


@dataclass(frozen=True)
class Row:
    """What is wrong (fields of `SynthConfig`, their sign the seed's), what is refined, and what the rig file states."""

    title: str
    errors: dict[str, float]
    refine: tuple[str, ...]
    std: CalibrationStd


_BOTH = ("baseline-direction", "focal")
_TWO = CalibrationStd(baseline_direction=0.02, thermal_focal=0.02)
ROWS = [
    Row("focal 2 %", {"thermal_focal_error": 0.02}, _BOTH, _TWO),
    Row("direction 2 %", {"rig_direction_error": 0.02}, _BOTH, _TWO),
    Row("length 1 %", {"rig_length_error": 0.01}, _BOTH, replace(_TWO, baseline_length=0.01)),
    Row("length 2 %", {"rig_length_error": 0.02}, _BOTH, replace(_TWO, baseline_length=0.02)),
    Row(
        "focal and direction 2 %, rotation 0.3°",
        {"thermal_focal_error": 0.02, "rig_direction_error": 0.02, "rig_rotation_error_deg": 0.3},
        ("rotation", *_BOTH),
        replace(_TWO, rotation_rad=math.radians(0.3)),
    ),
]


def true_values(written: Rig, true: Rig) -> dict[str, float]:
    """What a refinement of the written rig should come to, by the names and in the units of its posterior."""
    ta, tb = written.rgb_from_thermal.translation, true.rgb_from_thermal.translation
    turn = np.degrees(axis_angle_from_rotation(written.rgb_from_thermal.rotation.T @ true.rgb_from_thermal.rotation))
    sides = []
    for motion in motions(written, ["baseline-direction"]):
        ends = [motion.apply(written, amount).rgb_from_thermal.translation for amount in (1e-4, -1e-4)]
        side = ends[0] - ends[1]
        sides.append(side / np.linalg.norm(side))
    tips = [100 * float(side @ tb) / float(ta @ tb / np.linalg.norm(ta)) for side in sides]
    found = {f"rotation about {axis}": float(a) for axis, a in zip("xyz", turn, strict=True)}
    found |= {f"baseline direction, {i}": tip for i, tip in zip("ab", tips, strict=True)}
    return found | {"thermal focal length": 100 * (true.thermal.fl_x / written.thermal.fl_x - 1)}


def run_trial(trial: Trial, row: Row, seed: int, clean: list[np.ndarray]) -> dict[str, Any]:
    sign = -1.0 if seed % 2 else 1.0
    errors = {k: sign * v for k, v in row.errors.items()}
    scene = trial.scene(Variant(row.title, row.title, changes=errors), clean)
    rig = replace(scene.rig, calibration_std=row.std)
    scene = replace(scene, capture=replace(scene.capture, rig=rig))
    truth, product = trial.truth, 1 + errors.get("rig_length_error", 0.0)
    found: dict[str, Any] = {"scene": trial.config.scene, "seed": seed, "row": row.title}
    plain: ScaleEstimate | None = None
    for kind in ("plain", "refined"):
        started = time.process_time()
        if plain is None:
            estimate = plain = estimate_scale(scene, trial.model, ScaleConfig())
        else:  # from where the first ended, as `estimate_scale` does itself when it is told to refine
            config = ScaleConfig(refine=row.refine)
            estimate = refine(Problem.of(scene, trial.model, config), plain, widest=math.inf)
        found[kind] = {
            "error_pct": 100 * (estimate.sfm_per_metre / truth - 1),
            "product_error_pct": 100 * (estimate.sfm_per_metre * product / truth - 1),
            "std_pct": None if estimate.std_log is None else 100 * estimate.std_log,
            "covered": estimate.ci95 is not None and estimate.ci95[0] <= truth <= estimate.ci95[1],
            "status": estimate.status,
            "seconds": time.process_time() - started,
        }
        if estimate.refinement is not None:
            true = true_values(rig, true_rig(trial.config))
            found["freedoms"] = [
                {"name": f.name, "mean": f.mean, "std": f.std, "prior_std": f.prior_std, "true": true[f.name]}
                for f in estimate.refinement.freedoms
            ]
    return found


def markdown(trials: list[dict[str, Any]], title: str) -> str:
    lines = [
        f"### {title}",
        "",
        "| rig file wrong by | trials | plain: median, % | SR@2, % | refined: median, % | SR@2, % | median of s·\\|t\\|, % | ± (95 %), % "
        "| s covered | freedoms within 2 sd | seconds for it | with it / plain, time |",
        "|---|" + "---:|" * 11,
    ]
    for row in ROWS:
        mine = [t for t in trials if t["row"] == row.title]
        if not mine:
            continue
        plain, refined = ([t[kind] for t in mine] for kind in ("plain", "refined"))

        def median(found: list[dict[str, Any]], key: str = "error_pct") -> float:
            return float(np.median([abs(f[key]) for f in found]))

        def success(found: list[dict[str, Any]]) -> float:
            return 100 * float(np.mean([abs(f["error_pct"]) <= 2 for f in found]))

        freedom = [f for t in mine for f in t.get("freedoms", [])]
        honest = [abs(f["mean"] - f["true"]) <= 2 * f["std"] for f in freedom]
        width = np.median([1.96 * f["std_pct"] for f in refined if f["std_pct"] is not None])
        lines.append(
            f"| {row.title} | {len(mine)} | {median(plain):.2f} | {success(plain):.0f} | {median(refined):.2f} | {success(refined):.0f} "
            f"| {median(refined, 'product_error_pct'):.2f} | {width:.2f} | {sum(f['covered'] for f in refined)} of {len(mine)} "
            f"| {sum(honest)} of {len(honest)} | {np.median([f['seconds'] for f in refined]):.0f} "
            f"| {np.median([1 + r['seconds'] / p['seconds'] for p, r in zip(plain, refined, strict=True)]):.1f} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for scenes and trials")
    parser.add_argument("--size", type=int, default=400, help="width and height of both cameras' images")
    parser.add_argument("--frames", type=int, default=50, help="pairs a scene")
    parser.add_argument("--seeds", type=int, default=2, help="rigs a scene")
    parser.add_argument("--scenes", default=",".join(SCENES[:6]), help="which, separated by commas")
    parser.add_argument("--rows", default="", help="only those rows whose title begins with one of these, separated by commas")
    args = parser.parse_args()
    rows = [row for row in ROWS if row.title.startswith(tuple(args.rows.split(",")))]
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / "trials.jsonl"
    trials = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
    done = {(t["scene"], t["seed"], t["row"]) for t in trials}
    for seed in range(args.seeds):
        for name in args.scenes.split(","):
            missing = [row for row in rows if (name, seed, row.title) not in done]
            if not missing:
                continue
            config = SynthConfig(scene=name, frames=args.frames, size=args.size)
            prepare(args.out / "scenes" / name, config, RgbConfig(quality="fast"))
            trial = Trial.read(args.out / "scenes" / name, config, seed)
            clean = trial.temperatures(None)
            for row in missing:
                trials.append(run_trial(trial, row, seed, clean))
                with path.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(trials[-1]) + "\n")
    print(markdown(trials, f"{args.size} × {args.size}, {args.frames} pairs"))


if __name__ == "__main__":
    main()
