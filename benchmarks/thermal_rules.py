"""What each rule of the linear thermal fit is worth: the held-out error with the rule and without it.

    python benchmarks/thermal_rules.py --out DIR [--run ARCO_RUN] [--only RULE]

Makes small captures of the seven synthetic scenes and their RGB models in DIR (once), and puts into the photographs what a rule is made
for. "still": only the sensor's noise. "warming": an offset of up to 1 °C that changes slowly. "drifting": an offset of up to 1 °C and a
gain within 5 % about the mean, drawn anew for each frame. "vignetted": vignetting of 1 °C and readout stripes of 0.1 °C. "noisy": 0.5 °C
of noise, ten times as much. `--run` adds
real captures, by their run folders, as they are.

Prints Markdown: mean absolute errors over the held-out frames, averaged over the captures of a kind. "photographs": against the
photographs, with the drift predicted from the training frames beside each. "differences" (real captures): likewise, each frame's median
difference taken out, so that drift that nothing predicts is not in them. "scene": against the noise- and drift-free temperatures
(synthetic), the frame's median difference taken out, since offset and scene cannot be told apart. "worst": the largest change of a single
capture. Seconds are of the processor. Results are kept in DIR/rules.json and not measured again.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal
from unittest.mock import patch

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image

from rtgs.config import DriftKind, RgbConfig, RunConfig, SceneName, SfmConfig, SynthConfig, ThermalConfig
from rtgs.io.capture import load_capture
from rtgs.maths import sh
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.capture import Frame, Split
from rtgs.records.decision import Decision
from rtgs.records.scene import Scene
from rtgs.rgb.train import fit_rgb
from rtgs.run.config_file import SavedRun
from rtgs.run.folder import RunFolder
from rtgs.sfm.poses import run_sfm
from rtgs.synthetic import SCENES, write_capture
from rtgs.thermal import choices, fit
from rtgs.thermal.coverage import Coverage, measure_coverage
from rtgs.thermal.design import Design
from rtgs.thermal.fit import Fit, Fitted
from rtgs.thermal.frames import ThermalFrames
from rtgs.thermal.linear import fit_linear
from rtgs.thermal.settings import LinearSettings
from rtgs.thermal.validation import Validation

AskedDrift = Literal["auto", "off", "offset", "gain-offset"]
Change = Callable[[], AbstractContextManager[Any]]


@dataclass(frozen=True)
class Rule:
    """A rule, the captures it is made for, and the fit without it: other settings, or a changed function."""

    name: str
    kinds: tuple[str, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    drift: AskedDrift = "auto"
    change: Change = nullcontext


def _scene_mean_prior(design: Design, data: ThermalFrames, settings: LinearSettings, each: Callable[[], None]) -> Coverage:
    coverage = measure_coverage(design, data, settings, each)
    mean = float(torch.stack([i[data.valid > 0].mean() for i in data.images]).mean())
    prior = torch.zeros_like(coverage.prior)
    design.harmonics(prior)[:, 0], prior[-1] = mean / sh.C0, mean
    return replace(coverage, prior=prior)


_validation_of = Validation.of


def _no_surface(of: Fit, split: Split | None = None) -> Validation:
    return _validation_of(of, split).without_surface()


def _no_pattern(*_: Any) -> tuple[bool, Decision]:
    return False, Decision("pattern", "none", "without")


def _no_gains(_: Validation, kind: DriftKind, start: Fitted, asked: str) -> tuple[DriftKind, Fitted, Decision]:
    return kind, start, Decision("gains", "off", "without")


def _neighbours_mean(drift: NDArray[np.float64], levels: NDArray[np.float64], at: int) -> NDArray[np.float64]:
    return np.asarray(drift[max(at - 1, 0) : at + 1].mean(axis=0))


def _less_on_average(errors: torch.Tensor, before: torch.Tensor, share: float) -> bool:
    return float((before - errors).mean()) > share * float(before.mean())


def _predictions() -> AbstractContextManager[Any]:
    return patch("rtgs.models.sensor.predicted_drift", _neighbours_mean)


FIXED_ITERATIONS = {"stop_share_first": -math.inf, "stop_share_ridge": -math.inf, "iterations": 20}
RULES = (
    Rule("offsets, if frames drift", ("warming", "drifting", "arco"), drift="off"),
    Rule("gains, if frames have them", ("drifting", "arco"), change=lambda: patch.object(choices, "choose_gains", _no_gains)),
    Rule(
        "the sensor's pattern is removed",
        ("vignetted", "arco"),
        change=lambda: patch.object(choices, "choose_pattern", _no_pattern),
    ),
    Rule(
        "a common surface in the first solve", ("vignetted", "arco"), change=lambda: patch.object(Validation, "of", _no_surface)
    ),
    Rule(
        "clearly less: standard error and most frames (else the mean)",
        ("still", "warming", "arco"),
        change=lambda: patch.object(choices, "is_clearly_less", _less_on_average),
    ),
    Rule("a pattern needs 10 % (else 0.5 %)", ("still", "warming", "arco"), {"pattern_gain": 0.005}),
    Rule("drift is considered from 2 % on (else always)", ("still", "warming", "drifting", "arco"), {"drift_share": 0.0}),
    Rule("Huber's loss (else squares)", ("still", "arco"), {"huber": 1e6}),
    Rule("the ridge is chosen among four factors", ("still", "noisy", "drifting", "arco"), {"ridge_factors": (0.3,)}),
    Rule("the ridge grows with coverage", ("still", "noisy", "arco"), {"ridge_share": 0.0}),
    Rule(
        "prior: mean of the pixels covered (else of the scene)",
        ("still", "arco"),
        change=lambda: patch.object(fit, "measure_coverage", _scene_mean_prior),
    ),
    Rule("early stopping (else 20 iterations)", ("still", "noisy", "arco"), FIXED_ITERATIONS),
    Rule("last iterations on all frames", ("still", "noisy", "drifting", "arco"), {"last_iterations": 0}),
    Rule("neighbours' drift times their correlation", ("warming", "drifting", "arco"), change=_predictions),
    Rule("one row in several", ("arco",), {"pixels": 10**12}),
)


@dataclass(frozen=True)
class Problem:
    """A scene with its frozen model and scale, and its noise-free temperatures, which a real capture has not."""

    name: str
    kind: str
    scene: Scene
    rgb: RgbModel
    sfm_per_metre: float
    truth: Mapping[str, NDArray[np.float32]]


def of_run(path: Path, kind: str) -> Problem:
    folder = RunFolder(path)
    scene = folder.load_scene()
    clean = scene.capture.root / "ground_truth" / "thermal_clean"
    truth = {f.name: np.asarray(Image.open(clean / f"{f.name}.tiff")) for f in scene.frames} if clean.is_dir() else {}
    scale = folder.read_scale().sfm_per_metre if (path / "scale.json").exists() else 2.0
    return Problem(path.name, kind, scene, folder.read_rgb(), scale, truth)


def make(out: Path, name: SceneName, size: int, frames: int) -> Path:
    """A synthetic capture and its RGB model; made once."""
    folder, capture = RunFolder(out / f"{name}-{size}-{frames}"), out / f"{name}-{size}-{frames}-capture"
    if not (folder.path / "rgb.json").exists():
        write_capture(capture, SynthConfig(scene=name, frames=frames, size=size, supersampling=1, seed=3, sfm_per_metre=2.0))
        scene = run_sfm(load_capture(capture), SfmConfig())
        model = fit_rgb(scene, RgbConfig(steps=1500, sh_degree=1))
        folder.write_config(SavedRun(capture, RunConfig()))
        folder.write_scene(scene, None)
        folder.write_rgb(model, scene.given_from_world)
    return folder.path


def changed(problem: Problem, kind: str) -> Problem:
    """With the sensor of a kind: see above. Held-out frames have it too."""
    rng = np.random.default_rng(0)
    h, w = problem.scene.rig.thermal.height, problem.scene.rig.thermal.width
    y, x = np.linspace(-1, 1, h)[:, None], np.linspace(-1, 1, w)[None]
    stripes = 0.1 * (rng.standard_normal((h, 1)) + rng.standard_normal((1, w)))

    def photograph(index: int, frame: Frame) -> Frame:
        t, mean = frame.thermal.astype(np.float64), float(frame.thermal.mean())
        if kind == "warming":
            t = t + math.sin(2 * math.pi * index / 40)
        if kind == "drifting":
            t = mean + rng.uniform(-1, 1) + (1 + rng.uniform(-0.05, 0.05)) * (t - mean)
        if kind == "noisy":
            t = t + 0.5 * rng.standard_normal(t.shape)
        if kind == "vignetted":
            t = t + 2 / 3 - x**2 - y**2 + stripes
        return replace(frame, thermal=np.asarray(t, np.float32))

    capture = problem.scene.capture
    frames = tuple(photograph(i, f) for i, f in enumerate(capture.frames))
    return replace(problem, kind=kind, scene=replace(problem.scene, capture=replace(capture, frames=frames)))


def problems(args: argparse.Namespace) -> Iterator[Problem]:
    for path in args.run:
        yield of_run(path, "arco")
    for name in SCENES:
        plain = of_run(make(args.out, name, args.size, args.frames), "still")
        for kind in ("still", "warming", "drifting", "vignetted", "noisy"):
            yield plain if kind == "still" else changed(plain, kind)


def measured(problem: Problem, settings: LinearSettings, drift: AskedDrift) -> dict[str, float]:
    """Errors in °C, and seconds of the processor."""
    begin = time.process_time()
    config = ThermalConfig(drift=drift)
    model: ThermalModel = fit_linear(problem.scene, problem.rgb, problem.sfm_per_metre, config, settings=settings)
    seconds = time.process_time() - begin
    mask, photographs, scenes = problem.scene.capture.thermal_mask, [], []
    for frame in problem.scene.held_out_frames:
        pose = problem.scene.thermal_from_world(frame.name, model.sfm_per_metre)
        shown = model.render(problem.scene.rig.thermal, pose, photographed_in=frame.name)
        away = (shown - frame.thermal)[mask]
        photographs.append((float(np.abs(away).mean()), float(np.abs(away - np.median(away)).mean())))
        if problem.truth:
            error = (model.render(problem.scene.rig.thermal, pose) - problem.truth[frame.name])[mask]
            scenes.append(float(np.abs(error - np.median(error)).mean()))
    absolute, differences = (float(v) for v in np.mean(photographs, axis=0))
    found = {"photographs": absolute, "differences": differences, "seconds": seconds}
    return found | ({"scene": float(np.mean(scenes))} if scenes else {})


def table(results: Mapping[str, Mapping[str, Mapping[str, float]]]) -> str:
    """Of results[rule][kind/name]; "" is the fit with all rules."""
    rows = ["| rule | captures | of | with | without | change | worst | seconds |", "|---|---|---|---:|---:|---:|---:|---:|"]
    for rule in RULES:
        for kind in rule.kinds:
            keys = [k for k in results.get(rule.name, {}) if k.startswith(kind + "/")]
            for quantity in ("photographs", "differences", "scene"):
                if quantity == "differences" and any("scene" in results[""][k] for k in keys):
                    continue  # the truth says more
                pairs = [(results[""][k][quantity], results[rule.name][k][quantity]) for k in keys if quantity in results[""][k]]
                if not pairs:
                    continue
                a, b = np.mean(pairs, axis=0)
                worst = max((y / x - 1 for x, y in pairs), key=abs)
                seconds = np.mean([(results[""][k]["seconds"], results[rule.name][k]["seconds"]) for k in keys], axis=0)
                rows.append(
                    f"| {rule.name} | {kind} | {quantity} | {a:.4f} | {b:.4f} | {b / a - 1:+.1%} | {worst:+.1%} "
                    f"| {seconds[0]:.1f} → {seconds[1]:.1f} |"
                )
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="where captures, models and results are kept")
    parser.add_argument("--run", type=Path, action="append", default=[], help="a run folder of a real capture")
    parser.add_argument("--size", type=int, default=160)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--only", action="append", default=[], help="rules whose name begins so")
    args = parser.parse_args()
    file = args.out / "rules.json"
    results: dict[str, dict[str, dict[str, float]]] = json.loads(file.read_text()) if file.exists() else {}
    rules = [r for r in RULES if not args.only or r.name.startswith(tuple(args.only))]
    for problem in problems(args):
        for rule in (Rule("", (problem.kind,)), *rules):
            key = f"{problem.kind}/{problem.name}"
            if problem.kind not in rule.kinds or key in results.get(rule.name, {}):
                continue
            with rule.change():
                found = measured(problem, replace(LinearSettings(), **rule.settings), rule.drift)
            results.setdefault(rule.name, {})[key] = found
            file.write_text(json.dumps(results, indent=1, ensure_ascii=False))
    print(table(results))


if __name__ == "__main__":
    main()
