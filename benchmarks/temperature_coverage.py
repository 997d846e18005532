"""Do 95 % intervals of `temperature_std` hold the truth? Single Gaussians of the synthetic scenes.

    python benchmarks/temperature_coverage.py --out DIR         seven scenes, 160 × 160, 40 frames; captures of `thermal_rules.py`

Of every Gaussian that three training views see, the temperature is compared with two truths, both without noise: what the training views
show where it contributes to their pixels, and the temperature of the surface that they see in the direction of its mean. Gaussians that are
more than 3 % of the distance off the surface have no second truth. "width" is the median standard error, before and after calibration.
The factor between the two is from validation frames; no truth and no held-out frame has a part in it.

Prints Markdown.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.config import SCENES, ThermalConfig
from rtgs.models import ThermalModel
from rtgs.records.scene import Scene
from rtgs.synthetic import compiled_scene
from rtgs.thermal import fit_thermal, gaussian_temperatures
from rtgs.thermal.design import Design
from rtgs.thermal.frames import ThermalFrames
from rtgs.thermal.settings import CertaintySettings
from thermal_rules import Problem, make, of_run

FEWEST_VIEWS = 3
OFF_SURFACE = 0.03
SFM_PER_METRE = 2.0

Floats = NDArray[np.float64]


def truths(problem: Problem, model: ThermalModel) -> tuple[Floats, Floats]:
    """`[N]` each: what the training views show of a Gaussian without noise, and the surface's temperature; NaN where unknown."""
    scene: Scene = problem.scene
    data = ThermalFrames.of(scene, scene.train_frames, model.sfm_per_metre, model.color_range)
    design = Design(model.gaussians, scene.rig.thermal, data.poses, model.gaussians.sh_degree, model.settings)
    n, ray_caster = len(model.gaussians), compiled_scene(problem.name.split("-")[0])
    means = scene.given_from_world.apply(model.gaussians.means.numpy().astype(np.float64)) / model.sfm_per_metre
    shown, covered, surface, met = (np.zeros(n) for _ in range(4))
    for f, name in enumerate(data.names):
        clean = torch.from_numpy(problem.truth[name].astype(np.float32))
        weights = design.weights(f, torch.stack([torch.ones_like(clean), clean], dim=-1))[0].double().numpy()[:n]
        shown, covered = shown + weights[:, 1], covered + weights[:, 0]
        seen = np.flatnonzero(weights[:, 0] >= CertaintySettings().seen_px)
        eye = scene.given_from_world.apply(data.poses[f].inverse().translation) / model.sfm_per_metre
        towards = means[seen] - eye
        distance = np.linalg.norm(towards, axis=1)
        hits = ray_caster.hits(np.broadcast_to(eye, towards.shape), towards / distance[:, None])
        off = np.abs(np.linalg.norm(hits.surface.world - eye, axis=1) - distance[hits.ray])
        near = off <= OFF_SURFACE * distance[hits.ray]
        at = seen[hits.ray[near]]
        surface[at] += weights[at, 0] * ray_caster.temperature_c(hits)[near]
        met[at] += weights[at, 0]
    with np.errstate(invalid="ignore"):
        return shown / covered, surface / met


def line(problem: Problem) -> str:
    model = fit_thermal(problem.scene, problem.rgb, SFM_PER_METRE, ThermalConfig())
    raw = gaussian_temperatures(problem.scene, model, settings=CertaintySettings(calibrate=False))
    found = gaussian_temperatures(problem.scene, model)
    cells, seen = [], found.views >= FEWEST_VIEWS
    for truth in truths(problem, model):
        known = seen & np.isfinite(truth)
        off = np.abs(found.temperature - truth)[known]
        cells += [f"{np.mean(off <= 1.96 * r.std[known]):.1%}" for r in (raw, found)] + [f"{known.sum():,}"]
    width = [float(np.median(r.std[seen])) for r in (raw, found)]
    return f"| {problem.name.split('-')[0]} | {' | '.join(cells)} | {width[0]:.2f} → {width[1]:.2f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="where captures and models are kept")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--size", type=int, default=160)
    parser.add_argument("--frames", type=int, default=40)
    args = parser.parse_args()
    heads = [
        "scene",
        "as shown: noise alone",
        "calibrated",
        "Gaussians",
        "on the surface: noise alone",
        "calibrated",
        "Gaussians",
    ]
    print(f"| {' | '.join(heads)} | width, °C |\n|---|" + "---:|" * 7)
    for name in args.scenes:
        print(line(of_run(make(args.out, name, args.size, args.frames), "still")), flush=True)


if __name__ == "__main__":
    main()
