"""The scale of the seven synthetic scenes: the global search, and the paper's Adam from near the truth and from a scan.

    python benchmarks/synthetic_scale.py --size 200 --out DIR [--scenes lego,chair] [--seed 0]

For each scene: a capture is rendered, its points are triangulated from the given poses, the RGB model is trained, and the scale is
found three times: by the global search, the default; by the paper's Adam from truth × s0, s0 ~ U(0.5, 2.0); and by Adam from the
minimum of a scan, which needs no start. What is in DIR already is kept, scene by scene. `ground_truth.json` is read for the start and
for the error alone.

Prints a Markdown table and writes `DIR/synthetic_scale.csv`. Times are processor seconds, all threads together.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
import time
import zlib
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from rtgs.config import DensifyConfig, RgbConfig, ScaleConfig, SfmConfig
from rtgs.fit_rgb import fit_rgb
from rtgs.io.capture import load_capture
from rtgs.models import RgbModel
from rtgs.pipeline import RunFolder
from rtgs.scale import ScaleEstimate, estimate_scale
from rtgs.scene import Scene
from rtgs.sfm import run_sfm
from rtgs.synthetic import SCENES, SynthConfig, write_capture


@dataclass(frozen=True)
class Row:
    """One line of the table. Errors are 100 · |ŝ − s| / s."""

    scene: str
    points: int
    psnr_db: float
    gaussians: int
    true_scale: float
    start_factor: float
    scale: float
    error_pct: float
    scan_minimum: float
    scan_scale: float
    scan_error_pct: float
    scan_status: str
    search_scale: float
    search_error_pct: float
    search_half_width_pct: float
    search_status: str
    search_renders: int
    sfm_s: float
    rgb_s: float
    adam_s: float
    scan_s: float
    search_s: float


class Timings:
    """Processor seconds by stage, kept in the scene's folder: a stage that is not repeated keeps its time."""

    def __init__(self, folder: RunFolder) -> None:
        self.folder = folder
        self.seconds: dict[str, float] = folder.read_json("timings.json") if (folder.path / "timings.json").exists() else {}

    def record(self, stage: str, started: float) -> None:
        self.seconds[stage] = time.process_time() - started
        self.folder.write_json("timings.json", self.seconds)


def prepare(folder: RunFolder, synth: SynthConfig, rgb: RgbConfig, timings: Timings) -> tuple[Scene, RgbModel]:
    """Capture, poses with points, and RGB model: made where they are missing."""
    capture_path = folder.path / "capture"
    if not (capture_path / "rig.json").exists():
        started = time.process_time()
        write_capture(capture_path, synth)
        timings.record("capture", started)
    capture = load_capture(capture_path)
    if not (folder.path / "scene").exists():
        started = time.process_time()
        folder.write_scene(run_sfm(capture, SfmConfig(seed=synth.seed)), None)
        timings.record("sfm", started)
    scene = folder.read_scene(capture)
    if not (folder.path / "rgb.json").exists():
        started = time.process_time()
        folder.write_rgb(fit_rgb(scene, rgb))
        timings.record("rgb", started)
    return scene, folder.read_rgb()


def estimate(folder: RunFolder, name: str, scene: Scene, model: RgbModel, config: ScaleConfig, timings: Timings) -> ScaleEstimate:
    path = folder.path / f"{name}.json"
    if not path.exists():
        started = time.process_time()
        folder.write_json(path.name, estimate_scale(scene, model, config).to_json())
        timings.record(name, started)
    return ScaleEstimate.from_json(folder.read_json(path.name))


def run_scene(folder: RunFolder, synth: SynthConfig, rgb: RgbConfig, scan_steps: int) -> Row:
    folder.path.mkdir(parents=True, exist_ok=True)
    timings = Timings(folder)
    scene, model = prepare(folder, synth, rgb, timings)
    truth = json.loads((folder.path / "capture" / "ground_truth.json").read_text(encoding="utf-8"))["sfm_per_metre"]
    factor = float(np.random.default_rng([synth.seed, zlib.crc32(synth.scene.encode())]).uniform(0.5, 2.0))
    paper = estimate(folder, "scale_from_start", scene, model, ScaleConfig(solver="adam", init=truth * factor), timings)
    free = estimate(folder, "scale_from_scan", scene, model, ScaleConfig(solver="adam", steps=scan_steps), timings)
    search = estimate(folder, "scale", scene, model, ScaleConfig(solver="global"), timings)
    psnr = model.history["held_out_psnr"]
    return Row(
        scene=synth.scene,
        points=len(scene.points),
        psnr_db=psnr[-1] if psnr else float("nan"),
        gaussians=len(model.gaussians),
        true_scale=truth,
        start_factor=factor,
        scale=paper.sfm_per_metre,
        error_pct=100 * abs(paper.sfm_per_metre / truth - 1),
        scan_minimum=free.init,
        scan_scale=free.sfm_per_metre,
        scan_error_pct=100 * abs(free.sfm_per_metre / truth - 1),
        scan_status=free.status,
        search_scale=search.sfm_per_metre,
        search_error_pct=100 * abs(search.sfm_per_metre / truth - 1),
        search_half_width_pct=50 * math.log(search.ci95[1] / search.ci95[0]) if search.ci95 else float("nan"),
        search_status=search.status,
        search_renders=search.renders,
        sfm_s=timings.seconds["sfm"],
        rgb_s=timings.seconds["rgb"],
        adam_s=timings.seconds["scale_from_start"],
        scan_s=timings.seconds["scale_from_scan"],
        search_s=timings.seconds["scale"],
    )


def markdown(rows: list[Row], title: str, scan_steps: int) -> str:
    lines = [
        f"### {title}",
        "",
        f"| scene | points | RGB PSNR, dB | Gaussians | true s | s0 / s | Adam: s | error, % | scan + {scan_steps} steps: s | error, % "
        "| search: s | error, % | ± (95 %), % | renders | SfM, s | RGB, s | Adam, s | scan, s | search, s |",
        "|---|" + "---:|" * 18,
    ]
    for r in rows:
        scan = f"{r.scan_scale:.5g}" + ("" if r.scan_status == "ok" else f" ({r.scan_status})")
        search = f"{r.search_scale:.5g}" + ("" if r.search_status == "ok" else f" ({r.search_status})")
        lines.append(
            f"| {r.scene} | {r.points:,} | {r.psnr_db:.2f} | {r.gaussians:,} | {r.true_scale:.5g} | {r.start_factor:.3f} "
            f"| {r.scale:.5g} | {r.error_pct:.2f} | {scan} | {r.scan_error_pct:.2f} "
            f"| {search} | {r.search_error_pct:.2f} | {r.search_half_width_pct:.2f} | {r.search_renders} "
            f"| {r.sfm_s:.0f} | {r.rgb_s:.0f} | {r.adam_s:.0f} | {r.scan_s:.0f} | {r.search_s:.1f} |"
        )
    worst = max(rows, key=lambda r: r.error_pct)
    within = sum(r.error_pct <= 2 for r in rows)
    lines += ["", f"Adam from s0: {within} of {len(rows)} within 2 %, the worst is {worst.scene} with {worst.error_pct:.2f} %."]
    return "\n".join(lines)


def read_rows(path: Path) -> list[Row]:
    if not path.exists():
        return []
    types = {"str": str, "int": int, "float": float}
    with path.open(encoding="utf-8", newline="") as file:
        return [Row(**{f.name: types[str(f.type)](record[f.name]) for f in fields(Row)}) for record in csv.DictReader(file)]


def write_rows(path: Path, rows: list[Row]) -> None:
    part = path.with_suffix(".part")
    with part.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(Row)])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    part.replace(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for captures, models and the table")
    parser.add_argument("--size", type=int, default=200, help="width and height of both cameras' images")
    parser.add_argument("--frames", type=int, default=50, help="pairs a scene")
    parser.add_argument("--seed", type=int, default=0, help="of the capture, the start s0 and the training")
    parser.add_argument("--scenes", default=",".join(SCENES), help="which, separated by commas")
    parser.add_argument("--rgb-steps", type=int, default=1000, help="training steps of the RGB model")
    parser.add_argument("--max-gaussians", type=int, help="budget of the RGB model; by default what suits the pictures")
    parser.add_argument("--scan-steps", type=int, default=40, help="Adam steps after the scan")
    args = parser.parse_args()
    names = args.scenes.split(",")
    if unknown := set(names) - set(SCENES):
        parser.error(f"--scenes: no scene named {sorted(unknown)[0]!r}; there are {', '.join(SCENES)}")

    rgb = RgbConfig(steps=args.rgb_steps, seed=args.seed, densify=DensifyConfig(max_gaussians=args.max_gaussians))
    synth = {name: SynthConfig(scene=name, frames=args.frames, size=args.size, seed=args.seed) for name in SCENES}
    args.out.mkdir(parents=True, exist_ok=True)
    settings = {k: v for k, v in vars(args).items() if k not in ("out", "scenes")}
    settings_path = args.out / "settings.json"
    if settings_path.exists() and json.loads(settings_path.read_text(encoding="utf-8")) != settings:
        parser.error(f"--out {args.out}: holds results of other settings ({settings_path.name}); name another folder")
    settings_path.write_text(json.dumps(settings, indent=1) + "\n", encoding="utf-8")

    table = args.out / "synthetic_scale.csv"
    rows = read_rows(table)
    for name in names:
        if any(row.scene == name for row in rows):
            continue
        rows.append(run_scene(RunFolder(args.out / name), synth[name], rgb, args.scan_steps))
        rows.sort(key=lambda row: SCENES.index(row.scene))
        write_rows(table, rows)
        print(f"{name}: done", file=sys.stderr)
    title = f"Scale recovery at {args.size} × {args.size}, {args.frames} pairs, seed {args.seed}"
    print(markdown(rows, title, args.scan_steps))


if __name__ == "__main__":
    main()
