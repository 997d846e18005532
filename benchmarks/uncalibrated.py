"""A rig that is not known, found from synthetic captures: its errors, and whether it is ever sure and wrong.

    python benchmarks/uncalibrated.py --out DIR [--size 400] [--frames 50] [--scenes room,chair,lego,materials,plain] [--seeds 3]
        [--run RUN --focal 764.7]

A seed draws the rig: turned by 2 to 8°, a baseline of 0.1 to 0.3 m sideways, up or forward. The rig file gives the size and a field of
view 5 % off of the thermal camera, the length of the baseline, and nothing else of the rig; poses and RGB intrinsics are given. What DIR
holds already is kept (one RGB model a scene; `trials.jsonl`). Prints a Markdown table, one trial a row. "times" is the processor's time of
the scale stage over that of the same stage with the true rig.

With RUN, the run of a calibrated capture, there is a second table: its rig is reduced to the thermal camera's size and this focal length
in pixels, and found with the run's RGB model. What counts is where the sparse points fall in the thermal images, beside where `rig.json`
puts them.
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

from rtgs.base.json_records import write_json
from rtgs.config import RgbConfig, SynthConfig
from rtgs.experiments.trials import Trial, prepare
from rtgs.io.capture import load_capture
from rtgs.io.rig import rig_to_json
from rtgs.maths.geometry import SE3, axis_angle_from_rotation, rotation_from_axis_angle
from rtgs.records.rig import Rig, RigStart
from rtgs.run.folder import RunFolder
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
    scene, seconds = replace(trial.base, capture=capture), list[float]()
    for rig_of in (rig, hidden):  # the calibrated stage, and the one that has to find the rig
        started = time.process_time()
        given = replace(capture, rig=replace(rig_of, rgb=hidden.rgb))
        found = estimate_scale(replace(scene, capture=given), trial.model)
        seconds.append(time.process_time() - started)
    assert found.refinement is not None and found.calibration is not None
    focal = next(f for f in found.refinement.freedoms if f.name == "thermal focal length")
    turned = [f for f in found.refinement.freedoms if f.name.startswith("rotation about ")]
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
        "focal_std_pct": focal.std,
        "rotation_std_deg": math.sqrt(sum(f.std**2 for f in turned)),
        "seen": found.calibration.baseline_seen,
        "seconds": seconds[1],
        "times": seconds[1] / seconds[0],
    }


def run_real(run: Path, focal_px: float, out: Path) -> dict[str, Any]:
    """A run's rig, reduced to a focal length and found again."""
    folder = RunFolder(run)
    capture, scale, model = folder.load_capture(), folder.read_scale(), folder.read_rgb()
    given = folder.read_scene(capture, refined=False)
    thermal = replace(capture.raw_rig.thermal, fl_x=focal_px, fl_y=focal_px, k1=0.0, k2=0.0, k3=0.0, k4=0.0, p1=0.0, p2=0.0)
    data = rig_to_json(replace(capture.raw_rig, thermal=thermal), capture.radiometry)
    data["thermal"] = {name: value for name, value in data["thermal"].items() if name not in ("cx", "cy")}
    del data["rgb_from_thermal"]
    reduced = out / "capture"
    reduced.mkdir(parents=True, exist_ok=True)
    for path in capture.root.iterdir():
        if path.name != "rig.json" and not (reduced / path.name).exists():
            (reduced / path.name).symlink_to(path.resolve())
    (reduced / "rig.json").write_text(json.dumps(data), encoding="utf-8")
    scene, started = (
        folder.read_scene(load_capture(reduced, rgb_max_side=max(given.rig.rgb.width, given.rig.rgb.height)), refined=False),
        time.process_time(),
    )
    found = estimate_scale(scene, model)
    seconds = time.process_time() - started
    write_json(out / f"scale_{focal_px:g}.json", found)
    assert found.calibration is not None
    after, apart = found.refined_scene(scene), list[np.ndarray]()
    for frame in given.frames:
        seen = given.thermal_from_world(frame.name, scale.sfm_per_metre).apply(given.points.xyz)
        camera, moved = given.rig.thermal, after.thermal_from_world(frame.name, found.sfm_per_metre).apply(given.points.xyz)
        with np.errstate(all="ignore"):
            pixels = camera.project(seen)
            distance = np.linalg.norm(after.rig.thermal.project(moved) - pixels, axis=1)
        inside = (seen[:, 2] > 0) & (pixels > 0).all(axis=1) & (pixels < [camera.width, camera.height]).all(axis=1)
        apart.append(distance[inside])
    pixels = np.concatenate(apart)
    return {
        "focal given, px": focal_px,
        "focal found, px": after.rig.thermal.fl_x,
        "points: median, px": float(np.median(pixels)),
        "90 %, px": float(np.percentile(pixels, 90)),
        "baseline": "seen" if found.calibration.baseline_seen else "not seen",
        "its length, SfM units": found.calibration.baseline_sfm,
        "± (95 %), %": None if found.calibration.baseline_std_log is None else 196 * found.calibration.baseline_std_log,
        "contrast": found.calibration.contrast,
        "status": found.status,
        "seconds": seconds,
    }


def show(rows: list[dict[str, Any]]) -> None:
    """A Markdown table."""
    print("| " + " | ".join(rows[0]) + " |\n|" + "---|" * len(rows[0]))
    for row in rows:
        print("| " + " | ".join(f"{v:.3g}" if isinstance(v, float) else str(v) for v in row.values()) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for scenes and trials")
    parser.add_argument("--size", type=int, default=400, help="width and height of both cameras' images")
    parser.add_argument("--frames", type=int, default=50, help="pairs a scene")
    parser.add_argument("--seeds", type=int, default=3, help="rigs a scene")
    parser.add_argument("--scenes", default="room,chair,lego,materials,plain", help="which, separated by commas")
    parser.add_argument("--run", type=Path, help="run of a calibrated capture")
    parser.add_argument("--focal", default="764.7", help="with --run: focal lengths that are given, separated by commas")
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
    if trials:
        show(trials)
    if args.run is not None:
        print()
        show([run_real(args.run, float(focal), args.out / "real") for focal in args.focal.split(",")])


if __name__ == "__main__":
    main()
