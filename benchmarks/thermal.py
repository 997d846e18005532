"""The thermal fit by least squares against the paper's Adam, on the same frozen model.

    python benchmarks/thermal.py --run RUN [--run RUN2]                       any run folder that has its scale
    python benchmarks/thermal.py --scene lego --size 200 --out DIR            a synthetic capture, at its true scale
    … --offset-c 1 --gain 0.05                                                with drift, put in after loading

Adam's rate and number of steps are tuned by PSNR on every 8th training frame, which it does not see meanwhile; then it is fitted again on
all training frames. Least squares gets no tuning from outside. Nothing is fitted to a held-out frame.

Prints Markdown. PSNR and MAE are of held-out photographs, renders with the drift that the frames beside them let expect and with the
sensor's pattern, where a model has them. "MAE, differences": a held-out frame's median error is taken out, for all methods alike.
"MAE, truth": of the scene, against the noise- and drift-free temperatures of a synthetic capture. Seconds are of the processor, all
threads together, the first row's the median of three fits; evaluation is not in them. "To best" is the run with the best validation PSNR.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from rtgs.config import DensifyConfig, RgbConfig, RunConfig, SfmConfig, SynthConfig, ThermalConfig
from rtgs.io.capture import load_capture
from rtgs.metrics.basic import mae, psnr
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.rgb.train import fit_rgb
from rtgs.run.config_file import SavedRun
from rtgs.run.folder import RunFolder
from rtgs.sfm.poses import run_sfm
from rtgs.synthetic import SCENES, write_capture
from rtgs.thermal import fit_thermal

Images = Mapping[str, NDArray[np.float32]]


@dataclass(frozen=True)
class Score:
    psnr_db: float
    mae: float
    differences: float
    truth: float | None


@dataclass(frozen=True)
class Problem:
    """A scene with its frozen model and scale; `truth` is empty for a real capture."""

    name: str
    scene: Scene
    rgb: RgbModel
    sfm_per_metre: float
    truth: Images


def score(problem: Problem, scene: Scene, model: ThermalModel) -> Score:
    """Means over the held-out frames of `scene`."""
    rows, truths, mask = [], [], scene.capture.thermal_mask
    for frame in scene.held_out_frames:
        pose = scene.thermal_from_world(frame.name, model.sfm_per_metre)
        image = model.render(scene.rig.thermal, pose, photographed_in=frame.name)
        error = (image - frame.thermal)[mask]
        a, b = model.range.normalise(image), model.range.normalise(frame.thermal)
        rows.append((psnr(a, b, mask=mask), float(np.abs(error).mean()), float(np.abs(error - np.median(error)).mean())))
        if frame.name in problem.truth:
            truths.append(mae(model.render(scene.rig.thermal, pose), problem.truth[frame.name], mask=mask))
    psnr_db, absolute, differences = (float(v) for v in np.mean(rows, axis=0))
    return Score(psnr_db, absolute, differences, truth=float(np.mean(truths)) if truths else None)


def timed(scene: Scene, problem: Problem, config: ThermalConfig) -> tuple[ThermalModel, float]:
    start = time.process_time()
    model = fit_thermal(scene, problem.rgb, problem.sfm_per_metre, config)
    return model, time.process_time() - start


def tuned_adam(problem: Problem, rates: list[float], steps: list[int]) -> tuple[ThermalConfig, float]:
    """The settings with the best validation PSNR, and the seconds that fit took."""
    capture = problem.scene.capture
    inner = replace(problem.scene, capture=replace(capture, frames=problem.scene.train_frames))  # every 8th of these is held out
    best: tuple[float, ThermalConfig, float] | None = None
    for rate in rates:
        for count in steps:
            config = ThermalConfig(solver="adam", learning_rate=rate, steps=count)
            model, seconds = timed(inner, problem, config)
            reached = score(problem, inner, model).psnr_db
            print(f"    adam {rate:g}, {count} steps: validation {reached:.3f} dB, {seconds:.1f} s", flush=True)
            if best is None or reached > best[0]:
                best = reached, config, seconds
    assert best is not None
    return best[1], best[2]


def report(problem: Problem, rates: list[float], steps: list[int]) -> None:
    scene = problem.scene
    unit = scene.capture.radiometry.unit
    print(f"\n{problem.name}: {len(problem.rgb.gaussians):,} Gaussians, {len(scene.train_frames)} training frames of ", end="")
    print(f"{scene.rig.thermal.width} × {scene.rig.thermal.height}\n", flush=True)
    for config in (ThermalConfig(), ThermalConfig(solver="adam", steps=2)):
        # Kernels are compiled or loaded before the clock runs.
        fit_thermal(scene, problem.rgb, problem.sfm_per_metre, config)
    rows: list[tuple[str, Score, float]] = []
    runs = [timed(scene, problem, ThermalConfig()) for _ in range(3)]  # short: one may meet with something else on the machine
    linear, seconds = runs[0][0], sorted(s for _, s in runs)[1]
    chosen = {d.name: d.choice for d in linear.decisions}
    kind = "gain and offset" if chosen["gains"] == "on" else chosen["drift"]
    rows.append((f"least squares (drift: {kind}, chosen)", score(problem, scene, linear), seconds))
    for drift in ("off", "offset", "gain-offset"):
        model, other = timed(scene, problem, ThermalConfig(drift=drift))
        rows.append((f"least squares, drift {drift}", score(problem, scene, model), other))
    if steps:
        config, to_best = tuned_adam(problem, rates, steps)
        model, adam_s = timed(scene, problem, config)
        label = f"Adam, rate {config.learning_rate:g}, {config.steps:,} steps"
        rows.append((label, score(problem, scene, model), adam_s))
        longest = ThermalConfig(solver="adam", learning_rate=config.learning_rate, steps=max(steps))
        if longest.steps != config.steps:
            model, adam_s = timed(scene, problem, longest)
            rows.append((f"Adam, rate {longest.learning_rate:g}, {longest.steps:,} steps", score(problem, scene, model), adam_s))
    print(
        f"\n| {problem.name} | PSNR, dB | MAE, {unit} | MAE, differences | MAE, truth | seconds |\n|---|---:|---:|---:|---:|---:|"
    )
    for label, s, row_s in rows:
        truth = f"{s.truth:.4f}" if s.truth is not None else ""
        print(f"| {label} | {s.psnr_db:.3f} | {s.mae:.4f} | {s.differences:.4f} | {truth} | {row_s:.1f} |")
    if steps:
        print(
            f"\nSeconds as a share of Adam's to its best: {seconds / to_best:.3f}; of the longest: {seconds / adam_s:.3f}",
            flush=True,
        )


def of_run(path: Path) -> Problem:
    folder = RunFolder(path)
    scene = folder.load_scene()
    return Problem(path.name, scene, folder.read_rgb(), folder.read_scale().sfm_per_metre, truth_of(scene))


def of_synthetic(args: argparse.Namespace, out: Path) -> Problem:
    """Made once; a folder that is there is used again."""
    config = SynthConfig(
        scene=args.scene, frames=args.frames, size=args.size, seed=args.seed, netd_c=args.netd_c, sfm_per_metre=2.0
    )
    name = f"{args.scene}-{args.size}-{args.frames}-{args.seed}-{args.netd_c:g}-{args.rgb_steps}"
    name += f"-{args.gaussians}" if args.gaussians else ""
    folder = RunFolder(out / name)
    if not (folder.path / "rgb.json").exists():
        write_capture(out / f"{name}-capture", config)
        scene = run_sfm(load_capture(out / f"{name}-capture"), SfmConfig())
        model = fit_rgb(scene, RgbConfig(steps=args.rgb_steps, densify=DensifyConfig(max_gaussians=args.gaussians)))
        folder.write_config(SavedRun(out / f"{name}-capture", RunConfig()))
        folder.write_scene(scene, config.sfm_per_metre)
        folder.write_rgb(model, scene.given_from_world)
    scene = folder.load_scene()
    return Problem(name, scene, folder.read_rgb(), 2.0, truth_of(scene))


def truth_of(scene: Scene) -> Images:
    clean = scene.capture.root / "ground_truth" / "thermal_clean"
    return {f.name: np.asarray(Image.open(clean / f"{f.name}.tiff")) for f in scene.frames} if clean.is_dir() else {}


def drifting(problem: Problem, offset_c: float, gain: float) -> Problem:
    """Every frame, held-out ones too, with an offset and with a contrast about its mean, drawn uniformly."""
    rng = np.random.default_rng(0)

    def changed(frame: Frame) -> Frame:
        mean, by, times = frame.thermal.mean(), rng.uniform(-offset_c, offset_c), 1.0 + rng.uniform(-gain, gain)
        return replace(frame, thermal=(mean + by + times * (frame.thermal - mean)).astype(np.float32))

    capture = problem.scene.capture
    scene = replace(problem.scene, capture=replace(capture, frames=tuple(changed(f) for f in capture.frames)))
    return replace(problem, name=f"{problem.name}, ± {offset_c:g} °C and {100 * gain:g} % of contrast", scene=scene)


def listed(kind: Callable[[str], object]) -> Callable[[str], list[object]]:
    return lambda text: [kind(v) for v in text.split(",") if v]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, action="append", default=[])
    parser.add_argument("--scene", choices=SCENES)
    parser.add_argument("--out", type=Path, help="where the synthetic capture and its model are kept")
    parser.add_argument("--size", type=int, default=200)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--netd-c", type=float, default=0.05)
    parser.add_argument(
        "--rgb-steps", type=int, default=RgbConfig().resolved().steps, help="as many as `rtgs run` takes, by default"
    )
    parser.add_argument("--gaussians", type=int, help="budget of the RGB model; by default one for four pixels of an image")
    parser.add_argument("--offset-c", type=float, default=0.0)
    parser.add_argument("--gain", type=float, default=0.0)
    parser.add_argument("--rates", type=listed(float), default=[1e-2, 5e-2])
    parser.add_argument("--steps", type=listed(int), default=[300, 1000, 3000, 10000, 30000], help="empty: without Adam")
    args = parser.parse_args()
    problems = [of_run(path) for path in args.run]
    if args.scene:
        if args.out is None:
            parser.error("--scene needs --out")
        problems.append(of_synthetic(args, args.out))
    if not problems:
        parser.error("name a --run or a --scene")
    for problem in problems:
        if args.offset_c or args.gain:
            problem = drifting(problem, args.offset_c, args.gain)
        report(problem, args.rates, args.steps)


if __name__ == "__main__":
    main()
