"""A rig that is not known, found from synthetic captures: its errors, and whether it is ever sure and wrong.

    python benchmarks/uncalibrated.py --out DIR [--size 400] [--frames 50] [--scenes room,chair,lego,materials,plain] [--seeds 3]

A seed draws the rig: turned by 2 to 8°, a baseline of 0.1 to 0.3 m sideways, up or forward. The rig file gives the size and a field of
view 5 % off of the thermal camera, the length of the baseline, and nothing else of the rig; poses and RGB intrinsics are given. What DIR
holds already is kept (one RGB model a scene; `trials.jsonl`). Prints a Markdown table, one trial a row.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rtgs.config import RgbConfig, SynthConfig
from rtgs.experiments.trials import Trial, prepare
from rtgs.maths.geometry import SE3, axis_angle_from_rotation, rotation_from_axis_angle
from rtgs.records.rig import Rig, RigStart
from rtgs.scale import estimate_scale
from rtgs.synthetic import compiled_scene, render_thermal
from rtgs.synthetic.camera_path import camera_path
from rtgs.synthetic.capture import frame_names
from rtgs.synthetic.rig import true_rig
from rtgs.synthetic.sensor import RADIOMETRY, contrast_gains, noise_rng, record_thermal

_SIDES = ((1.0, 0.1, 0.05), (0.1, -1.0, 0.05), (0.2, 0.1, 1.0))


def drawn_rig(config: SynthConfig, seed: int) -> tuple[Rig, float]:
    """The true rig of a seed, and the factor by which its focal length is written wrong."""
    rng, rig = np.random.default_rng([seed, 17]), true_rig(config)
    side = np.array(_SIDES[seed % 3]) * rng.choice([-1, 1]) + rng.normal(0, 0.1, 3)
    baseline = rng.uniform(0.1, 0.3) * side / np.linalg.norm(side)
    axis = rng.normal(size=3)
    turn = rotation_from_axis_angle(math.radians(rng.uniform(2, 8)) * axis / np.linalg.norm(axis))
    thermal = replace(rig.thermal, cx=rig.thermal.width / 2, cy=rig.thermal.height / 2)
    return Rig(rig.rgb, thermal, SE3(turn, baseline)), float(rng.choice([0.95, 1.05]))


def run_trial(folder: Path, config: SynthConfig, seed: int) -> dict[str, Any]:
    """One rig in one scene."""
    trial, (rig, zoom) = Trial.read(folder, config, seed), drawn_rig(config, seed)
    model, drawn, frames = compiled_scene(config.scene), replace(config, rig_seed=seed), []
    poses = camera_path(config, model.model.centre)
    for i, (gain, _) in enumerate(zip(contrast_gains(drawn), frame_names(drawn), strict=True)):
        clean = render_thermal(model, rig.thermal, poses[i] @ rig.rgb_from_thermal, config.supersampling)
        image = RADIOMETRY.celsius(record_thermal(clean, drawn, float(gain), noise_rng(drawn, i)))
        frames.append(trial.base.capture.frames[i].with_thermal(image))
    thermal = replace(rig.thermal, fl_x=zoom * rig.thermal.fl_x, fl_y=zoom * rig.thermal.fl_y)
    pose = SE3(np.eye(3), np.array([rig.baseline_m, 0.0, 0.0]))
    hidden = Rig(trial.base.rig.rgb, thermal, pose, start=RigStart(baseline_m=rig.baseline_m, centre_known=True))
    mask = np.ones((thermal.height, thermal.width), dtype=bool)
    capture = replace(trial.base.capture, rig=hidden, raw_rig=hidden, frames=tuple(frames), thermal_mask=mask)
    scene, started = replace(trial.base, capture=capture), time.process_time()
    found = estimate_scale(scene, trial.model)
    seconds = time.process_time() - started
    after, error = found.refined_scene(scene).rig, found.sfm_per_metre / trial.truth - 1
    turn = axis_angle_from_rotation(after.rgb_from_thermal.rotation.T @ rig.rgb_from_thermal.rotation)
    return {
        "scene": config.scene,
        "seed": seed,
        "status": found.status,
        "rotation_deg": math.degrees(float(np.linalg.norm(turn))),
        "focal_pct": 100 * (after.thermal.fl_x / rig.thermal.fl_x - 1),
        "baseline_pct": 100 * error,
        "covered": None if found.ci95 is None else found.ci95[0] <= trial.truth <= found.ci95[1],
        "std_pct": None if found.std_log is None else 100 * found.std_log,
        "seconds": seconds,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for scenes and trials")
    parser.add_argument("--size", type=int, default=400, help="width and height of both cameras' images")
    parser.add_argument("--frames", type=int, default=50, help="pairs a scene")
    parser.add_argument("--seeds", type=int, default=3, help="rigs a scene")
    parser.add_argument("--scenes", default="room,chair,lego,materials,plain", help="which, separated by commas")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / "trials.jsonl"
    trials = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
    done = {(t["scene"], t["seed"]) for t in trials}
    for name in args.scenes.split(","):
        config = SynthConfig(scene=name, frames=args.frames, size=args.size)
        for seed in range(args.seeds):
            if (name, seed) in done:
                continue
            prepare(args.out / "scenes" / name, config, RgbConfig(quality="fast"))
            trials.append(run_trial(args.out / "scenes" / name, config, seed))
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(trials[-1]) + "\n")
    columns = ("scene", "seed", "status", "rotation_deg", "focal_pct", "baseline_pct", "std_pct", "covered", "seconds")
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    for trial in trials:
        cells = [f"{trial[c]:.3g}" if isinstance(trial[c], float) else str(trial[c]) for c in columns]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
