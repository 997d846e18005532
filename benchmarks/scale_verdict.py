"""Does the verdict notice when a scale is not to be trusted? Deliberately poor captures, and good ones, drawn by seed.

    python benchmarks/scale_verdict.py --out DIR [--poor 45] [--good 10] [--jobs 1]

`--poor` RGB models are trained on captures of drawn scene, size (64 to 200 pixels), number of frames (6 to 24), steps (100 to 2,000) and,
for a fifth of them, a budget of 100 to 1,500 Gaussians; one in twenty shows a plain at 800 m. Each is seen by three rigs with drawn noise
and blur, and some with a rotation that rig.json has wrong by 0.2° to 2°, with thermal images of another scene, or with shuffled pairs.
`--good` RGB models (128 pixels, 24 frames, quality `fast`) are each seen by four rigs without any of that.

A run is wrong where the status is "ok" and the truth lies outside of the 95 % interval by more than half of its half-width, which is 1.5
half-widths from its middle. Rules were chosen on the poor RGB models below number 18; the others are reported for themselves.

What was found, with the frames' loss curves, is one line a run in `DIR/runs.jsonl`. Runs that are there are not repeated, and the rules of
the verdict are applied to the kept curves without rendering: call again with another version to see what it makes of the same runs.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import from_json
from rtgs.config import SCENES, DensifyConfig, RgbConfig, ScaleConfig, SynthConfig
from rtgs.experiments.trials import SceneFacts, Trial, prepare
from rtgs.experiments.variants import Variant
from rtgs.models import RgbModel
from rtgs.records.scene import Scene
from rtgs.scale.bracket import Bracket
from rtgs.scale.curves import LocalCurves
from rtgs.scale.interval import Interval, interval_of
from rtgs.scale.misfit import NO_MISFIT, Misfit, misfit
from rtgs.scale.objective import FrameLoss
from rtgs.scale.problem import Found, Problem
from rtgs.scale.records import History, Minimum
from rtgs.scale.solvers import SOLVERS
from rtgs.scale.verdict import Verdict, verdict_of

RIGS = {"poor": 3, "good": 4}
CHOSEN_ON = 18  # poor RGB models below this number were looked at when the rules were chosen
WRONG = 1.5  # half-widths from the middle of the interval
Kind = Literal["poor", "good"]


@dataclass(frozen=True)
class Run:
    """One line of `runs.jsonl`.

    Attributes:
        kind, number, rig: which RGB model and which of its rigs. damage: "none", "rotation", "other" (scene) or "shuffled" (pairs).
        changes: fields of `SynthConfig`. budget: of Gaussians; None: by the quality.
        truth: `sfm_per_metre`. psnr_db: of the RGB model on held-out frames.
        refused: why there is no answer; then nothing below counts.
        theta, doubt, closed, blur_px: as in `Found`. disagreeing: how many frames do. minima: likewise, (scale, loss above, chance).
        bracket: both ends. misfit_px: as in `Misfit`.
        thetas, losses, slopes: the frames' curves, `[S]` and `[F, S]`.
    """

    kind: Kind
    number: int
    rig: int
    scene: str
    size: int
    frames: int
    steps: int
    budget: int | None
    damage: str
    changes: dict[str, float]
    truth: float
    psnr_db: float
    refused: str = ""
    theta: float = 0.0
    doubt: str = ""
    closed: bool = False
    blur_px: float = 0.0
    disagreeing: int = 0
    minima: tuple[tuple[float, float, float], ...] = ()
    bracket: tuple[float, float] = (1.0, 1.0)
    misfit_px: float = 0.0
    thetas: tuple[float, ...] = ()
    losses: tuple[tuple[float, ...], ...] = ()
    slopes: tuple[tuple[float, ...], ...] = ()

    @property
    def key(self) -> tuple[str, int, int]:
        return self.kind, self.number, self.rig

    def judged(self, *, earlier: bool = False) -> tuple[Verdict, Interval]:
        """What the rules make of the kept curves; `earlier`: without misfit and disagreement, as version 0.1.0 did."""
        if self.refused:
            return Verdict("unobservable", self.refused), Interval(None, None, None)
        frames = range(len(self.losses))
        found_there = {
            (i, t): FrameLoss(self.losses[i][k], self.slopes[i][k], math.nan) for i in frames for k, t in enumerate(self.thetas)
        }
        curves = LocalCurves(None, tuple(frames), self.thetas, found_there)  # type: ignore[arg-type]  # nothing is rendered
        found = Found(
            self.theta,
            math.exp(self.theta),
            curves,
            self.closed,
            History(),
            0,
            self.doubt,
            minima=tuple(Minimum(*m) for m in self.minima),
            disagreeing=() if earlier else ("",) * self.disagreeing,
            blur_px=self.blur_px,
        )
        missed = NO_MISFIT if earlier else Misfit(self.misfit_px, 0)
        interval = interval_of(found, Bracket(*self.bracket), None, missed, ScaleConfig().seed)
        return verdict_of(found, interval), interval

    def off(self, interval: Interval) -> float:
        """Distance of the truth from the middle of an interval, in half-widths."""
        if interval.ci95 is None:
            return math.inf
        lo, hi = (math.log(end) for end in interval.ci95)
        return abs(math.log(self.truth) - (lo + hi) / 2) / ((hi - lo) / 2)


@dataclass(frozen=True)
class Drawn:
    """An RGB model: what it is trained from, and how."""

    config: SynthConfig
    rgb: RgbConfig


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def drawn_model(kind: Kind, number: int) -> Drawn:
    """The RGB model of a number."""
    if kind == "good":
        scene, size, frames, steps, budget = SCENES[number % len(SCENES)], 128, 24, 1500, None
    else:
        rng = np.random.default_rng([number, 1])
        scene = rng.choice([*SCENES, "plain"], p=[0.135] * 7 + [0.055])
        size, frames = round(log_uniform(rng, 64, 201)), int(rng.integers(6, 25))
        steps = round(log_uniform(rng, 100, 2000))
        budget = round(log_uniform(rng, 100, 1500)) if rng.random() < 0.2 else None
    config = SynthConfig(scene=str(scene), frames=frames, size=size, seed=number, thermal_clean=False, supersampling=1)  # type: ignore[arg-type]
    return Drawn(config, RgbConfig(quality="fast", steps=steps, densify=DensifyConfig(max_gaussians=budget)))


def drawn_rig(kind: Kind, number: int, rig: int) -> tuple[str, dict[str, float], np.random.Generator]:
    """The damage of a rig, changes of its settings, and the random numbers that are left for the damage."""
    rng = np.random.default_rng([number, 2, rig])
    if kind == "good":
        return "none", {}, rng
    changes = {"netd_c": log_uniform(rng, 0.02, 2.0) if rng.random() < 0.6 else 0.05}
    changes["blur_px"] = float(rng.uniform(0.5, 3)) if rng.random() < 0.4 else 0.0
    damage = str(rng.choice(["none", "rotation", "other", "shuffled"], p=[0.4, 0.3, 0.15, 0.15]))
    if damage == "rotation":
        changes["rig_rotation_error_deg"] = log_uniform(rng, 0.2, 2.0)
    return damage, changes, rng


def searched(scene: Scene, model: RgbModel) -> dict[str, Any]:
    """The fields of `Run` that a search gives."""
    problem = Problem.of(scene, model, ScaleConfig())
    found = SOLVERS["global"].solve(problem)
    missed = NO_MISFIT if found.doubt else misfit(scene, model, found.curves, found.theta, problem.progress)
    return {
        "theta": found.theta,
        "doubt": found.doubt,
        "closed": found.closed,
        "blur_px": found.blur_px,
        "disagreeing": len(found.disagreeing),
        "minima": [(m.sfm_per_metre, m.loss_above, m.chance) for m in found.minima],
        "bracket": list(problem.bracket),
        "misfit_px": missed.px,
        "thetas": found.curves.thetas,
        "losses": found.curves.values().tolist(),
        "slopes": found.curves.slopes().tolist(),
    }


def runs_of(out: Path, kind: Kind, number: int, rigs: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Train an RGB model, or read it, and look for the scale with some rigs."""
    drawn = drawn_model(kind, number)
    folder = out / f"{kind}.{number}"
    prepare(folder, drawn.config, drawn.rgb)
    psnr_db = SceneFacts.read(folder).psnr_db
    for rig in rigs:
        damage, changes, rng = drawn_rig(kind, number, rig)
        trial = Trial.read(folder, drawn.config, rig)
        shown = trial
        if damage == "other":
            other = str(rng.choice([s for s in SCENES if s != drawn.config.scene]))
            shown = replace(trial, config=replace(trial.config, scene=other))  # type: ignore[arg-type]
        clean = shown.temperatures(None)
        if damage == "shuffled":
            clean = [clean[i] for i in rng.permutation(len(clean))]
        row: dict[str, Any] = {
            "kind": kind,
            "number": number,
            "rig": rig,
            "scene": drawn.config.scene,
            "size": drawn.config.size,
            "frames": drawn.config.frames,
            "steps": drawn.rgb.steps,
            "budget": drawn.rgb.densify.max_gaussians,
            "damage": damage,
            "changes": changes,
            "truth": trial.truth,
            "psnr_db": psnr_db,
        }
        try:
            row |= searched(trial.scene(Variant("drawn", "drawn", changes=changes), clean), trial.model)
        except RtgsError as error:
            row["refused"] = str(error)
        yield row
    shutil.rmtree(folder / "capture" / "ground_truth", ignore_errors=True)


def work(out: Path, kind: Kind, number: int, rigs: Sequence[int]) -> list[dict[str, Any]]:
    """`runs_of` in a process of its own."""
    import numba
    import torch

    numba.set_num_threads(1)
    torch.set_num_threads(1)
    return list(runs_of(out, kind, number, rigs))


def kept_runs(path: Path) -> dict[tuple[str, int, int], Run]:
    """The lines of a `runs.jsonl`; none where there is no such file."""
    if not path.exists():
        return {}
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    runs = [from_json(Run, row, str(path)) for row in rows]
    return {run.key: run for run in runs}


def share(count: int, of: int) -> str:
    return f"{count} ({100 * count / of:.1f} %)" if of else "–"


def line(name: str, runs: Sequence[Run], *, earlier: bool) -> str:
    """A row of the table."""
    judged = [(run, *run.judged(earlier=earlier)) for run in runs]
    ok = [(run, interval) for run, verdict, interval in judged if verdict.status == "ok"]
    wrong = sum(run.off(interval) > WRONG for run, interval in ok)
    held = sum(run.off(interval) <= 1 for run, interval in ok)
    width = f"{100 * float(np.median([i.half_width for _, i in ok])):.2g} %" if ok else "–"
    cells = [
        name,
        "0.1.0" if earlier else "now",
        len(runs),
        share(len(ok), len(runs)),
        share(wrong, len(runs)),
        share(held, len(ok)),
        width,
    ]
    return f"| {' | '.join(str(cell) for cell in cells)} |"


def table(runs: Sequence[Run]) -> str:
    """Markdown: how many are "ok", and how many of these are wrong."""
    poor, good = ([run for run in runs if run.kind == kind] for kind in ("poor", "good"))
    groups = {
        f"poor, models below {CHOSEN_ON} (rules chosen on)": [r for r in poor if r.number < CHOSEN_ON],
        f"poor, models from {CHOSEN_ON} on": [r for r in poor if r.number >= CHOSEN_ON],
        **{f"poor, {damage}": [r for r in poor if r.damage == damage] for damage in ("none", "rotation", "other", "shuffled")},
        "poor, all": poor,
        "good, all": good,
    }
    head = "| runs | rules | number | ok | ok and wrong | ok: ci95 holds the truth | ok: median half-width |\n|---|---|---|---|---|---|---|"
    return "\n".join([head, *(line(name, some, earlier=e) for name, some in groups.items() for e in (True, False))])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--poor", type=int, default=45)
    parser.add_argument("--good", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=1)
    o = parser.parse_args()
    o.out.mkdir(parents=True, exist_ok=True)
    path = o.out / "runs.jsonl"
    kept = kept_runs(path)
    numbers: list[tuple[Kind, int]] = [("poor", n) for n in range(o.poor)] + [("good", n) for n in range(o.good)]
    missing = {(kind, n): [k for k in range(RIGS[kind]) if (kind, n, k) not in kept] for kind, n in numbers}
    missing = {key: rigs for key, rigs in missing.items() if rigs}
    with ProcessPoolExecutor(o.jobs, get_context("spawn")) as pool:
        jobs = [pool.submit(work, o.out, kind, n, rigs) for (kind, n), rigs in missing.items()]
        for count, job in enumerate(as_completed(jobs), 1):
            with path.open("a", encoding="utf-8") as file:
                file.writelines(json.dumps(row) + "\n" for row in job.result())
            print(f"\r{count}/{len(jobs)} RGB models ", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    wanted = set(numbers)
    print(table([run for run in kept_runs(path).values() if (run.kind, run.number) in wanted]))


if __name__ == "__main__":
    main()
