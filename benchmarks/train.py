"""Held-out PSNR of the RGB model against training seconds, for the quality presets.

    python benchmarks/train.py CAPTURE --out DIR [--presets fast default best] [--seeds 0 1] [--threads 2] [--times-four] [--scale]

Each preset is trained by `rtgs.fit_rgb` on the capture's training frames, once a seed: where few frames are held out, a seed changes more
than a preset, so presets are compared by their means over seeds. `--times-four` adds `best` with four times its steps: what is
left to gain. `--scale` also finds the metric scale with each model, same settings, and compares it with that of `best`. What is in DIR
already is kept, preset by preset.

Writes `DIR/train.csv`, `DIR/train.md` and `DIR/train.png`, and prints the table and the comparisons. Seconds are wall-clock without the
scoring of held-out frames: the twenty-odd steps that end with a scoring count as much as the step before.
"""

from __future__ import annotations

import argparse
import csv
import json
import statistics
import sys
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import rtgs  # before torch and Numba, whose threads it keeps from spinning

# isort: split
import matplotlib
import numba
import torch

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from rtgs.config import QUALITIES, RgbConfig, ScaleConfig
from rtgs.models import RgbModel
from rtgs.renderer import RenderSettings

TIMES_FOUR = "best, 4 × the steps"
COLORS = dict(zip((*QUALITIES, TIMES_FOUR), ("#4c9f70", "#2f6db5", "#b5482f", "#999999"), strict=True))


@dataclass(frozen=True)
class Curve:
    """One training. Lists have one entry a scoring."""

    name: str
    seed: int
    steps: int
    threads: int
    step: list[int]
    seconds: list[float]
    gaussians: list[int]
    psnr_db: list[float]


class Clock:
    """Training seconds by step, taken from the progress calls of `fit_rgb`, which scores before it calls."""

    def __init__(self, scorings: int) -> None:
        self.scorings = scorings
        self.seconds = [0.0]
        self.last, self.lap = time.perf_counter(), 0.0

    def __call__(self, step: int, steps: int, text: str) -> None:
        now = time.perf_counter()
        every = max(steps // self.scorings, 1)
        if step % every and step != steps:
            self.lap = now - self.last
        self.seconds.append(self.seconds[-1] + self.lap)
        self.last = now
        if step % every == 0:
            print(f"\r{step}/{steps}: {self.seconds[-1]:.0f} s, {text}  ", end="", file=sys.stderr, flush=True)


def train(name: str, scene: rtgs.Scene, config: RgbConfig, threads: int, out: Path) -> Curve:
    """Train, or read what was trained before."""
    slug = slug_of(name, config.seed)
    record = out / f"{slug}.json"
    if not record.exists():
        clock = Clock(scorings=20)  # as `fit_rgb` has it
        model = rtgs.fit_rgb(scene, config, progress=clock)
        print(file=sys.stderr)
        rtgs.write_ply(out / f"{slug}.ply", model.gaussians)
        history = model.history
        steps = [int(s) for s in history["step"]]
        curve = Curve(
            name,
            config.seed,
            steps[-1],
            threads,
            steps,
            [clock.seconds[s] for s in steps],
            [int(n) for n in history["gaussians"]],
            list(history["held_out_psnr"]),
        )
        settings = {"background": model.background.tolist(), "settings": asdict(model.settings)}
        write_json(record, {"curve": asdict(curve), "config": repr(config.resolved()), **settings})
    data = json.loads(record.read_text(encoding="utf-8"))
    if data["config"] != repr(config.resolved()) or data["curve"]["threads"] != threads:
        raise SystemExit(f"{record}: was trained with other settings or threads; name another --out")
    return Curve(**{"seed": 0, **data["curve"]})


def slug_of(name: str, seed: int) -> str:
    return "".join(c if c.isalnum() else "_" for c in name) + (f"_seed_{seed}" if seed else "")


def find_scale(name: str, seed: int, scene: rtgs.Scene, out: Path) -> float:
    slug = slug_of(name, seed)
    path = out / f"{slug}.scale.json"
    if not path.exists():
        record = json.loads((out / f"{slug}.json").read_text(encoding="utf-8"))
        gaussians = rtgs.read_ply(out / f"{slug}.ply")
        model = RgbModel(gaussians, torch.tensor(record["background"]), RenderSettings(**record["settings"]))

        def progress(done: int, total: int, text: str) -> None:
            if done % 100 == 0:
                print(f"\rscale, {slug}: {done}/{total}, {text}  ", end="", file=sys.stderr, flush=True)

        estimate = rtgs.estimate_scale(scene, model, ScaleConfig(), progress=progress)
        print(file=sys.stderr)
        write_json(path, estimate)
    return float(json.loads(path.read_text(encoding="utf-8"))["sfm_per_metre"])


def write_json(path: Path, data: Any) -> None:
    part = path.with_suffix(".part")
    part.write_text(json.dumps(data) + "\n", encoding="utf-8")
    part.replace(path)


def write_csv(path: Path, curves: list[Curve]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["preset", "seed", "threads", "step", "seconds", "gaussians", "held_out_psnr_db"])
        for c in curves:
            for row in zip(c.step, c.seconds, c.gaussians, c.psnr_db, strict=True):
                writer.writerow([c.name, c.seed, c.threads, *row])


def seconds_to(curve: Curve, psnr_db: float) -> float | None:
    """When the curve first reaches a PSNR."""
    return next((s for s, p in zip(curve.seconds, curve.psnr_db, strict=True) if p >= psnr_db), None)


def final_psnr(curves: list[Curve], name: str) -> float | None:
    """Mean over seeds, dB."""
    ends = [c.psnr_db[-1] for c in curves if c.name == name]
    return statistics.fmean(ends) if ends else None


def markdown(curves: list[Curve], scales: dict[tuple[str, int], float]) -> str:
    best = final_psnr(curves, "best")
    goal = None if best is None else best - 0.5
    header = ["quality", "seed", "steps", "Gaussians", "seconds", "ms a step", "held out, dB"]
    header += [] if goal is None else [f"seconds to {goal:.2f} dB"]
    header += ["sfm_per_metre"] if scales else []
    lines = ["| " + " | ".join(header) + " |", "|---|" + "---:|" * (len(header) - 1)]
    for c in curves:
        cells = [c.name, str(c.seed), f"{c.steps:,}", f"{c.gaussians[-1]:,}", f"{c.seconds[-1]:.0f}"]
        cells += [f"{1e3 * c.seconds[-1] / c.steps:.1f}", f"{c.psnr_db[-1]:.2f}"]
        if goal is not None:
            reached = seconds_to(c, goal)
            cells.append("–" if reached is None else f"{reached:.0f}")
        if scales:
            cells.append(f"{scales[c.name, c.seed]:.5g}" if (c.name, c.seed) in scales else "")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def comparisons(curves: list[Curve], scales: dict[tuple[str, int], float]) -> list[str]:
    slowest = {name: max(c.seconds[-1] for c in curves if c.name == name) for name in {c.name for c in curves}}
    default, best, longest = (final_psnr(curves, name) for name in ("default", "best", TIMES_FOUR))
    lines = []
    if default is not None and best is not None:
        took = f"{slowest['default']:.0f} s"
        lines.append(f"default ends {best - default:+.2f} dB below best, after {took} (asked: at most 0.5 dB, 480 s).")
    if best is not None and longest is not None:
        lines.append(f"Four times the steps of best gain {longest - best:+.2f} dB (asked: at most 0.3 dB).")
    if "fast" in slowest:
        lines.append(f"fast took {slowest['fast']:.0f} s (asked: at most 120 s).")
    for (name, seed), value in scales.items():
        if name != "best" and ("best", seed) in scales:
            apart = 100 * (value / scales["best", seed] - 1)
            lines.append(f"The scale found with {name}, seed {seed}, differs from best's by {apart:+.2f} %.")
    return lines


def plot(path: Path, curves: list[Curve]) -> None:
    figure, axes = plt.subplots(figsize=(7.0, 3.6), constrained_layout=True)
    for c in curves:
        label = None if c.seed else f"{c.name}: {c.steps:,} steps"
        axes.plot(c.seconds, c.psnr_db, marker=".", label=label, color=COLORS.get(c.name), alpha=0.5 if c.seed else 1.0)
    axes.set(xscale="log", xlabel=f"training time, s ({curves[0].threads} threads)", ylabel="held-out PSNR, dB")
    axes.grid(True, which="both", alpha=0.3)
    figure.legend(loc="outside upper center", ncols=2, fontsize="small")  # beside the curves, not on them
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="folder with rgb/, thermal/ and rig.json")
    parser.add_argument("--out", type=Path, required=True, help="folder for models, table and curve")
    parser.add_argument("--presets", nargs="+", choices=QUALITIES, default=list(QUALITIES))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rgb-max-side", type=int, default=960, help="RGB images are reduced to this many pixels")
    parser.add_argument("--times-four", action="store_true", help="also train best with four times its steps")
    parser.add_argument("--scale", action="store_true", help="also find the metric scale with each model")
    args = parser.parse_args()
    most = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]  # Numba sets it from the environment
    if args.threads > most:
        parser.error(f"--threads {args.threads}: Numba was given {most} (NUMBA_NUM_THREADS)")
    torch.set_num_threads(args.threads)
    numba.set_num_threads(args.threads)
    args.out.mkdir(parents=True, exist_ok=True)

    scene = rtgs.run_sfm(rtgs.load_capture(args.capture, rgb_max_side=args.rgb_max_side))
    if not scene.held_out_frames:
        raise SystemExit(f"{args.capture}: no held-out frame is registered, so there is nothing to score")
    # Compiling is no training: it happens once an installation.
    rtgs.fit_rgb(scene, RgbConfig(steps=8, seed=1))

    runs = [(name, RgbConfig(quality=name, seed=seed)) for seed in args.seeds for name in args.presets]
    if args.times_four:
        best = RgbConfig(quality="best", seed=args.seeds[0])
        steps = best.resolved().steps
        assert steps is not None  # a quality gives them
        runs.append((TIMES_FOUR, replace(best, steps=4 * steps)))
    curves, scales = [], {}
    for name, config in runs:
        curves.append(train(name, scene, config, args.threads, args.out))
        if args.scale and name != TIMES_FOUR:
            scales[name, config.seed] = find_scale(name, config.seed, scene, args.out)
        write_csv(args.out / "train.csv", curves)
        plot(args.out / "train.png", curves)
    text = "\n".join([markdown(curves, scales), "", *comparisons(curves, scales)])
    (args.out / "train.md").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
