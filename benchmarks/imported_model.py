"""Are models in a wrong frame or unit told from right ones? What `--rgb-ply` looks at, for models that are moved on purpose.

    python benchmarks/imported_model.py --out DIR [--size 128] [--frames 24]

The RGB model of each of the seven scenes (quality `fast`) is compared with the photographs as it is; trained for 60 and 200 steps only;
turned about the middle of the scene and about the origin, scaled, shifted and mirrored; and in the place of the other scenes' models.
Instead of the model the cameras are moved the other way, which gives the same pictures. Models that are in DIR already are not made again.
Prints a Markdown table: the share of the photographs' detail that is explained. A model is refused where it is zero or less.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rtgs.config import SCENES, RgbConfig, SynthConfig
from rtgs.experiments.trials import prepare
from rtgs.io.capture import load_capture
from rtgs.maths.geometry import SE3, rotation_from_axis_angle
from rtgs.models import RgbModel
from rtgs.records.scene import Scene
from rtgs.rgb.photographs import Views
from rtgs.rgb.train import fit_rgb
from rtgs.run.folder import RunFolder


def explained(scene: Scene, model: RgbModel) -> float:
    """The share of the detail that a model explains, over the background that suits it best."""
    views = Views.of(scene, model)
    return views.likeness(views.best_background()).explained


def moved(
    scene: Scene, turn: NDArray[np.float64], about: NDArray[np.float64], factor: float, shift: NDArray[np.float64]
) -> Scene:
    """The scene as it looks to a model that has been turned and scaled about a point, and shifted."""

    def back(pose: SE3) -> SE3:
        return SE3(turn.T @ pose.rotation, turn.T @ (pose.translation - shift - about) / factor + about)

    return replace(scene, world_from_rgb={name: back(pose) for name, pose in scene.world_from_rgb.items()})


def mirrored(scene: Scene) -> Scene:
    """Photographs and principal point with left and right exchanged, and poses reflected in the plane x = 0."""
    flip = np.diag([-1.0, 1.0, 1.0])
    rig = scene.rig
    rgb = replace(rig.rgb, cx=rig.rgb.width - rig.rgb.cx)
    frames = tuple(replace(f, rgb=np.ascontiguousarray(f.rgb[:, ::-1])) for f in scene.capture.frames)
    capture = replace(scene.capture, frames=frames, rig=replace(rig, rgb=rgb), rgb_mask=scene.capture.rgb_mask[:, ::-1])
    poses = {name: SE3(flip @ pose.rotation @ flip, flip @ pose.translation) for name, pose in scene.world_from_rgb.items()}
    return replace(scene, capture=capture, world_from_rgb=poses)


def cases(scene: Scene, model: RgbModel) -> Iterator[tuple[str, float]]:
    """Names of cases and what is explained."""
    rng = np.random.default_rng(0)
    none, middle = np.zeros(3), np.median(model.gaussians.means.numpy().astype(np.float64), axis=0)

    def direction() -> NDArray[np.float64]:
        vector = rng.normal(size=3)
        return vector / np.linalg.norm(vector)

    yield "as it is", explained(scene, model)
    for steps in (200, 60):
        yield f"trained for {steps} steps", explained(scene, fit_rgb(scene, RgbConfig(quality="fast", steps=steps)))
    for degrees in (2, 5, 10, 90, 180):
        for about in (none, middle):
            turn = rotation_from_axis_angle(math.radians(degrees) * direction())
            yield f"turned by {degrees}°", explained(moved(scene, turn, about, 1.0, none), model)
    for factor in (0.5, 0.9, 0.95, 0.98, 1.02, 1.05, 1.1, 2.0):
        for about in (none, middle):
            yield f"scaled by {factor:g}", explained(moved(scene, np.eye(3), about, factor, none), model)
    for share in (0.01, 0.03, 0.1, 0.3):
        shift = share * scene.extent * direction()
        yield f"shifted by {100 * share:g} % of the scene's extent", explained(moved(scene, np.eye(3), none, 1.0, shift), model)
    yield "mirrored", explained(mirrored(scene), model)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--frames", type=int, default=24)
    o = parser.parse_args()
    o.out.mkdir(parents=True, exist_ok=True)
    models: dict[str, tuple[Scene, RgbModel]] = {}
    for name in SCENES:
        print(f"{name} ", end="", file=sys.stderr, flush=True)
        prepare(
            o.out / name, SynthConfig(scene=name, frames=o.frames, size=o.size, thermal_clean=False), RgbConfig(quality="fast")
        )
        run = RunFolder(o.out / name)
        models[name] = run.read_scene(load_capture(o.out / name / "capture")), run.read_rgb()
    found: dict[str, list[float]] = {}
    for shown, (scene, model) in models.items():
        print(f"\n{shown}", end="", file=sys.stderr, flush=True)
        for case, value in cases(scene, model):
            found.setdefault(case, []).append(value)
        for other, (_, foreign) in models.items():
            if other != shown:
                found.setdefault("of another scene", []).append(explained(scene, foreign))
    print(file=sys.stderr)
    print("| model | number | explained: least | median | most | refused |\n|---|---|---|---|---|---|")
    for case, values in found.items():
        least, median, most = (f"{100 * v:.1f} %" for v in np.percentile(values, [0, 50, 100]))
        print(f"| {case} | {len(values)} | {least} | {median} | {most} | {sum(v <= 0 for v in values)} |")


if __name__ == "__main__":
    main()
