"""Does the thermal model show what RGB does not? Spots, lines and a rectangle that only the thermal camera sees, in held-out views.

    python benchmarks/hot_spots.py --out DIR                                  room, hotdog and ship at 400 × 400, seeds 0 and 1
    … --scenes room --seeds 0 --size 160 --steps 1500                         a first look, in a minute or two
    … --variants frozen follow mine --set mine huber=1e6 ridge_px=0.003      a variant of your own: fields of `ThermalConfig` or of
                                                                              `LinearSettings`; --set may be given several times
    … --again mine                                                            measure a variant anew, after the code has changed

DIR/SCENE-SEED-SIZE-FRAMES-STEPS/ holds a capture and its RGB model, made once; DIR/results.json what was measured, for each capture and
variant. Both are used again by the next call; a call that was stopped goes on. "frozen", "follow" and "refine" are
`ThermalConfig.geometry`, "default" is `ThermalConfig()`.

Every variant is fitted to three sets of photographs that differ in nothing else, noise included: "plain" (no features), "features", and
"distractor" (features, and a warm ellipse in one training frame of ten). Held-out photographs have no distractor. Scores are against
noise-free temperatures at the same pixels (`hot_spot_scores.py`):

- share of the excess at the centre, median (10th percentile), by FWHM in thermal pixels, hot and cold; then over the disk where half of it
  is; of lines along their middle;
- edge: 10–90 % rise of the rectangle's edges, render against photograph;
- false: blobs of 3 px and more that are 3 °C and more off the truth, in each view, with features and without; in brackets those that are so
  far off every temperature that the truth has within 2 px: misplaced edges are not in them;
- MAE against the truth, in °C, with features and without;
- distractor: what the fit with the distractor shows more than the fit without it, where training photographs had it, as a share of it;
- seconds of the processor of the fit with features, and its Gaussians; the highest peak of memory of the three fits.

Prints Markdown: for each scene over its seeds, and for all; on standard error, for each capture as it is measured.
DIR/SCENE-….png shows crops of the features: truth, and every variant. Needs Linux for the memory.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import re
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture

from hot_spot_scores import Image, View, edge_widths, false_spots, shares, shown_of_distractors
from rtgs.config import FEATURES, SCENES, RgbConfig, RunConfig, SfmConfig, SynthConfig, ThermalConfig
from rtgs.images.pictures import palette, save_png, side_by_side
from rtgs.io.capture import load_capture
from rtgs.models import RgbModel, ThermalModel
from rtgs.records.scene import Scene
from rtgs.rgb.train import fit_rgb
from rtgs.run.config_file import SavedRun
from rtgs.run.folder import RunFolder
from rtgs.sfm.poses import run_sfm
from rtgs.synthetic import compiled_scene, write_capture
from rtgs.synthetic.capture import CLEAN, WITHOUT_FEATURES, GroundTruth, draw_truth
from rtgs.synthetic.placement import SPOT_SIZES_PX
from rtgs.synthetic.sensor import RADIOMETRY, noise_rng, record_thermal
from rtgs.thermal import fit_thermal
from rtgs.thermal.linear import fit_linear
from rtgs.thermal.settings import LinearSettings

SETS = ("plain", "features", "distractor")
LISTS = (
    "shares",
    "edges",
    "edges_photographed",
    "false",
    "false_2px",
    "false_plain",
    "false_plain_2px",
    "mae",
    "mae_plain",
    "distractor",
)
SFM_PER_METRE = 2.0
CROP_PX = 24  # half the side of a crop
_OF_CONFIG = {f.name: f for f in fields(ThermalConfig)}
_OF_NUMBERS = {f.name: f for f in fields(LinearSettings)}

Changes = Mapping[str, Any]


@dataclass(frozen=True)
class Problem:
    """A capture with features and a distractor, its RGB model, and what is true of it."""

    name: str
    scene: Scene
    rgb: RgbModel
    truth: GroundTruth

    def clean(self, folder: str, name: str) -> Image:
        """Noise-free temperatures of a frame, with features or without."""
        return np.asarray(Picture.open(self.scene.capture.root / folder / f"{name}.tiff"))

    def photographed(self, which: str) -> Scene:
        """The scene with the photographs of a set. Those with the distractor are the capture's own."""
        if which == "distractor":
            return self.scene
        folder, config, frames = CLEAN if which == "features" else WITHOUT_FEATURES, self.truth.config, []
        for i, frame in enumerate(self.scene.capture.frames):
            counts = record_thermal(self.clean(folder, frame.name), config, self.truth.gains[frame.name], noise_rng(config, i))
            frames.append(frame.with_thermal(RADIOMETRY.values(counts)))
        return replace(self.scene, capture=replace(self.scene.capture, frames=tuple(frames)))

    @cached_property
    def views(self) -> list[View]:
        """The held-out views. Their photographs have features and no distractor."""
        return [
            View(
                frame.name,
                self.truth.rig.thermal,
                self.truth.world_from_thermal[frame.name].inverse(),
                frame.thermal,
                self.clean(CLEAN, frame.name),
                self.clean(WITHOUT_FEATURES, frame.name),
            )
            for frame in self.scene.held_out_frames
        ]

    @cached_property
    def behind_distractors(self) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """By training frame: surface points `[P, 3]` that the distractor stands in front of, and its excess there `[P]`."""
        camera, found = self.truth.rig.thermal, {}
        for name, distractor in self.truth.distractors.items():
            excess, pose = distractor.excess(camera), self.truth.world_from_thermal[name]
            y, x = np.nonzero(excess > 0.5 * distractor.excess_c)
            rays = np.stack([(x + 0.5 - camera.cx) / camera.fl_x, (y + 0.5 - camera.cy) / camera.fl_y, np.ones(len(x))], axis=1)
            rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)) @ pose.rotation.T
            hits = compiled_scene(self.truth.config.scene).hits(np.broadcast_to(pose.translation, rays.shape), rays)
            found[name] = hits.surface.world, excess[y, x][hits.ray].astype(np.float64)
        return found

    def visible(self, view: View, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """`[P]`: which world points a view sees."""
        eye, local, pixels = (
            view.thermal_from_world.inverse().translation,
            view.thermal_from_world.apply(points),
            view.pixels(points),
        )
        inside = (local[:, 2] > 0) & (pixels >= 0).all(1) & (pixels < [view.camera.width, view.camera.height]).all(1)
        to = eye - points
        distance = np.linalg.norm(to, axis=1)
        to /= distance[:, None]
        return inside & ~compiled_scene(self.truth.config.scene).occluded(points + 0.01 * to, to, distance - 0.02)


def problem_of(out: Path, config: SynthConfig, steps: int | None) -> Problem:
    """Made once; a folder that is there is used again."""
    name = f"{config.scene}-{config.seed}-{config.size}-{config.frames}-{steps or 'default'}"
    folder, capture = RunFolder(out / name / "model"), out / name / "capture"
    if not (folder.path / "rgb.json").exists():
        print(f"{name}: making the capture and its RGB model", flush=True)
        write_capture(capture, config)
        scene = run_sfm(load_capture(capture), SfmConfig())
        model = fit_rgb(scene, RgbConfig(steps=steps))
        folder.write_config(SavedRun(capture, RunConfig()))
        folder.write_scene(scene, SFM_PER_METRE)
        folder.write_rgb(model, scene.given_from_world)
    return Problem(name, folder.load_scene(), folder.read_rgb(), draw_truth(config))


def fit(problem: Problem, scene: Scene, changes: Changes) -> tuple[ThermalModel, dict[str, float]]:
    """A model with changed settings; seconds of the processor, the peak of its memory in MB, and its Gaussians."""
    config = ThermalConfig(**{k: v for k, v in changes.items() if k in _OF_CONFIG})
    numbers = {k: v for k, v in changes.items() if k in _OF_NUMBERS}
    before, begin = reset_peak_mb(), time.process_time()
    if numbers:
        model = fit_linear(scene, problem.rgb, SFM_PER_METRE, config, settings=replace(LinearSettings(), **numbers))
    else:
        model = fit_thermal(scene, problem.rgb, SFM_PER_METRE, config)
    return model, {"seconds": time.process_time() - begin, "peak_mb": peak_mb() - before, "gaussians": len(model.gaussians)}


def reset_peak_mb() -> float:
    """Let the peak of this process's memory start from here; returns the memory in use, in MB.

    What earlier fits have freed is given back first: else a fit would take it again unseen.
    """
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")
    return peak_mb("VmRSS")


def peak_mb(field: str = "VmHWM") -> float:
    status = Path("/proc/self/status").read_text()
    found = re.search(rf"{field}:\s+(\d+)", status)
    assert found is not None
    return int(found[1]) / 1024


def measure(problem: Problem, changes: Changes) -> tuple[dict[str, Any], list[Image]]:
    """The scores of a variant, and its renders of the held-out views, with features."""
    renders: dict[str, list[Image]] = {}
    cost: dict[str, float] = {}
    scene, views, features = problem.scene, problem.views, problem.truth.features
    for which in SETS:
        model, used = fit(problem, problem.photographed(which), changes)
        renders[which] = [model.render(scene.rig.thermal, scene.thermal_from_world(v.name, model.sfm_per_metre)) for v in views]
        peak = max(used["peak_mb"], cost.get("peak_mb", 0.0))
        cost = {**(used if which == "features" else cost), "peak_mb": peak}
    found: dict[str, list[Any]] = {name: [] for name in LISTS}
    for i, view in enumerate(views):
        plain, shown, distracted = (renders[which][i] for which in SETS)
        found["shares"] += [asdict(s) for s in shares(features, view, shown)]
        found["edges"] += edge_widths(features, view, shown)
        found["edges_photographed"] += edge_widths(features, view, view.photograph)
        found["false"].append(false_spots(shown, view.with_features))
        found["false_2px"].append(false_spots(shown, view.with_features, within_px=2))
        found["false_plain"].append(false_spots(plain, view.without))
        found["false_plain_2px"].append(false_spots(plain, view.without, within_px=2))
        found["mae"].append(float(np.abs(shown - view.with_features).mean()))
        found["mae_plain"].append(float(np.abs(plain - view.without).mean()))
        places = problem.behind_distractors
        visible = {name: problem.visible(view, points) for name, (points, _) in places.items()}
        found["distractor"].append(shown_of_distractors(places, view, visible, distracted, shown))
    return {**found, **cost}, renders["features"]


def draw(path: Path, problem: Problem, rows: Mapping[str, Sequence[Image]]) -> None:
    """Crops of one feature of each kind and sign, each in the held-out view that sees it best: truth, and each variant's render."""
    columns, seen = [], set()
    for feature in problem.truth.features:
        key = (feature.kind, feature.size_px, feature.sign)
        distances = {
            i: float(view.thermal_from_world.apply(np.array(feature.position_m))[2])
            for i, view in enumerate(problem.views)
            if view.name in feature.views
        }
        if key in seen or not distances:
            continue
        seen.add(key)
        i = min(distances, key=lambda at: distances[at])
        view = problem.views[i]
        x, y = (int(round(float(v))) for v in view.pixels(np.array(feature.position_m)))
        half = CROP_PX * 2 if feature.kind == "rectangle" else CROP_PX
        part = (slice(max(y - half, 0), y + half), slice(max(x - half, 0), x + half))
        truth = view.with_features[part]
        lo, hi = float(truth.min()), float(truth.max())
        tiles = [palette(image[part], lo, hi) for image in (view.with_features, *(renders[i] for renders in rows.values()))]
        grown = [np.asarray(Picture.fromarray(t).resize((144, 144), Picture.Resampling.NEAREST)) for t in tiles]
        columns.append(side_by_side(grown, [f"{feature.kind} {feature.size_px:g} {'+' if feature.sign > 0 else '-'}", *rows]))
    half = (len(columns) + 1) // 2
    stacks = [np.concatenate(columns[:half]), np.concatenate(columns[half:])]
    height = max(s.shape[0] for s in stacks)
    stacks = [np.pad(s, ((0, height - s.shape[0]), (0, 12), (0, 0))) for s in stacks]
    save_png(path, np.concatenate(stacks, axis=1))


def spread(values: Sequence[float]) -> str:
    """Median (10th percentile)."""
    return f"{np.median(values):.2f} ({np.percentile(values, 10):.2f})" if len(values) else "–"


def rows_of(name: str, variant: str, found: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[str]]:
    """Lines of the table of shares, and the line of the other scores, of one variant on some captures together."""
    all_shares = [s for f in found for s in f["shares"]]
    lines = []
    for sign, word in ((1, "hot"), (-1, "cold")):
        own = [s for s in all_shares if s["sign"] == sign]
        cells = []
        for where in ("centre", "disk"):
            cells += [spread([s[where] for s in own if s["kind"] == "spot" and s["size_px"] == p]) for p in sorted(SPOT_SIZES_PX)]
        cells.append(spread([s["centre"] for s in own if s["kind"] == "line"]))
        lines.append(f"| {name} | {variant} | {word} | {' | '.join(cells)} |")
    flat = {key: [v for f in found for v in f[key]] for key in found[0] if isinstance(found[0][key], list)}
    edge, photographed = (float(np.median(flat[k])) if flat[k] else float("nan") for k in ("edges", "edges_photographed"))
    shown, total = np.sum(flat["distractor"], axis=0)
    cells = [
        f"{edge:.2f} / {photographed:.2f}",
        f"{np.mean(flat['false']):.1f} ({np.mean(flat['false_2px']):.1f})",
        f"{np.mean(flat['false_plain']):.1f} ({np.mean(flat['false_plain_2px']):.1f})",
        f"{np.mean(flat['mae']):.4f}",
        f"{np.mean(flat['mae_plain']):.4f}",
        f"{shown / total:.1%}",
        *(f"{np.mean([f[key] for f in found]):,.0f}" for key in ("seconds", "peak_mb", "gaussians")),
    ]
    return lines, [f"| {name} | {variant} | {' | '.join(cells)} |"]


def table(results: Mapping[str, Mapping[str, Any]], variants: Sequence[str]) -> str:
    """Of results[capture][variant]: a row for each scene, over its seeds, and for all."""
    sizes = [f"{p:g} px" for p in sorted(SPOT_SIZES_PX)]
    heads = ["scene", "variant", "", *sizes, *(f"disk {s}" for s in sizes), "lines"]
    shares_of = [f"| {' | '.join(heads)} |", "|---|---|---|" + "---:|" * (len(heads) - 3)]
    heads = [
        "scene",
        "variant",
        "edge, px: render / photograph",
        "false",
        "false, plain",
        "MAE",
        "MAE, plain",
        "distractor",
        "s",
        "MB",
    ]
    heads.append("Gaussians")
    others = [f"| {' | '.join(heads)} |", "|---|---|" + "---:|" * (len(heads) - 2)]
    scenes = sorted({key.split("-")[0] for key in results})
    for scene in [*scenes, *(["all"] if len(scenes) > 1 else [])]:
        for variant in variants:
            found = [r[variant] for key, r in results.items() if scene in ("all", key.split("-")[0]) and variant in r]
            if found:
                lines, line = rows_of(scene, variant, found)
                shares_of, others = shares_of + lines, others + line
    return "\n".join([*shares_of, "", *others])


def changes_of(settings: Sequence[Sequence[str]]) -> dict[str, dict[str, Any]]:
    """Variant → changed fields, from the command line: [name, field=value, …]."""
    found: dict[str, dict[str, Any]] = {"default": {}, **{g: {"geometry": g} for g in ("frozen", "follow", "refine")}}
    for name, *pairs in settings:
        changes = {}
        for pair in pairs:
            key, text = pair.split("=", 1)
            if key not in {**_OF_CONFIG, **_OF_NUMBERS}:
                raise SystemExit(f"--set {name}: no setting {key!r}")
            try:
                changes[key] = json.loads(text)
            except ValueError:
                changes[key] = text
            if isinstance(changes[key], list):
                changes[key] = tuple(changes[key])
        found[name] = changes
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="where captures, models and results are kept")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=["room", "hotdog", "ship"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1])
    parser.add_argument("--size", type=int, default=400, help="side of all images, in pixels")
    parser.add_argument("--frames", type=int, default=50)
    parser.add_argument("--steps", type=int, help="of the RGB model; by default as many as `rtgs run` takes")
    parser.add_argument("--variants", nargs="+", default=["frozen", "follow"])
    parser.add_argument("--set", nargs="+", action="append", default=[], metavar=("NAME", "FIELD=VALUE"))
    parser.add_argument("--again", nargs="+", default=[], metavar="VARIANT")
    args = parser.parse_args()
    known = changes_of(args.set)
    if unknown := [v for v in args.variants if v not in known]:
        parser.error(f"--variants: nothing is known of {unknown[0]}; --set says what it is")
    file = args.out / "results.json"
    kept: dict[str, dict[str, Any]] = json.loads(file.read_text()) if file.exists() else {}
    results: dict[str, dict[str, Any]] = {}
    for scene in args.scenes:
        for seed in args.seeds:
            config = SynthConfig(
                scene=scene,
                frames=args.frames,
                size=args.size,
                seed=seed,
                sfm_per_metre=SFM_PER_METRE,
                features=FEATURES,
                distractor=True,
            )
            problem = problem_of(args.out, config, args.steps)
            renders = {}
            for variant in args.variants:
                own = kept.setdefault(problem.name, {})
                stored = args.out / problem.name / f"{variant}.npy"
                if set(LISTS) - set(own.get(variant, ())) or variant in args.again or not stored.exists():
                    own[variant], images = measure(problem, known[variant])
                    np.save(stored, np.stack(images))
                    file.write_text(json.dumps(kept, indent=1))
                renders[variant] = np.load(stored)
            draw(args.out / f"{problem.name}.png", problem, renders)
            results[problem.name] = kept[problem.name]
            print(table({problem.name: results[problem.name]}, args.variants), file=sys.stderr, flush=True)
    print(table(results, args.variants))


if __name__ == "__main__":
    main()
