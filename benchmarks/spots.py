"""Does `rtgs spots` list what is there, and nothing else? A room with eight known spots on its surfaces, and the same room without.

    python benchmarks/spots.py --out DIR                        400 × 400, seeds 0 and 1
    … --seeds 0 --size 160 --steps 1500                         a first look

The spots are hot and cold by 15 °C, and 2, 3, 5 and 8 thermal pixels wide: `rtgs synth --scene room --features spots --spots-each 1`. DIR
keeps captures and models; a second call uses them again.

First table: each spot with the distance of the nearest listed one of its kind, area and temperature against the truth, whether the 95 %
interval holds the truth, and in how many of the photographs that see the place it was found. Second table: what else is listed, with
features and without. The room has warm things of its own. Each is checked against the noise-free image and the true surfaces: by how much
it really stands out from the same surface around it, and from everything around it ("–": where that is another surface).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hot_spots import Problem, fit, problem_of
from rtgs.config import SynthConfig
from rtgs.records.spots import Spot, SpotList
from rtgs.synthetic import compiled_scene
from rtgs.synthetic.capture import CLEAN, WITHOUT_FEATURES
from rtgs.thermal import find_spots
from rtgs.thermal.spot_regions import standing_out

NEAR_M, AREA, PEAK_C, LEAST_C = 0.02, 0.3, 1.0, 3.0


def true_excess(problem: Problem, spot: Spot, folder: str) -> tuple[float, float]:
    """By how much a place really stands out in the frames that show it best: from its own surface, and from whatever is around."""
    camera, model = problem.truth.rig.thermal, compiled_scene(problem.truth.config.scene)
    sign = 1.0 if spot.kind == "hot" else -1.0
    found = []
    for name in spot.best_frames:
        pose = problem.truth.world_from_thermal[name]
        local = pose.inverse().apply(np.array(spot.position_m))
        x, y = camera.project(local)
        reach = 3 + int(spot.diameter_m / 2 / local[2] * camera.fl_x)
        top, left = max(int(y) - reach - 21, 0), max(int(x) - reach - 21, 0)
        window = sign * problem.clean(folder, name)[top : int(y) + reach + 22, left : int(x) + reach + 22].astype(np.float64)
        rows, columns = np.mgrid[: window.shape[0], : window.shape[1]]
        rays = np.stack([(columns + left + 0.5 - camera.cx) / camera.fl_x, (rows + top + 0.5 - camera.cy) / camera.fl_y], axis=-1)
        rays = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1).reshape(-1, 3) @ pose.rotation.T
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        hits = model.hits(np.broadcast_to(pose.translation, rays.shape), rays)
        parts = np.full(window.size, -1)
        parts[hits.ray] = hits.surface.part
        near = np.hypot(rows + top + 0.5 - y, columns + left + 0.5 - x) <= reach
        at = np.unravel_index(int(np.where(near, window, -np.inf).argmax()), window.shape)
        own = np.where(parts.reshape(window.shape) == parts.reshape(window.shape)[at], 1.0, np.nan)
        place = np.array([at[0]]), np.array([at[1]])
        contrasts = [standing_out(window, depth, *place)[0][0] for depth in (own, np.ones_like(own))]
        found.append(contrasts)
    same, anything = np.max(found, axis=0)
    return float(same), float(anything)


def feature_rows(problem: Problem, listed: SpotList, seed: int) -> Iterator[tuple[str, int | None]]:
    """A line for each feature, and which listed spot it is."""
    for feature in problem.truth.features:
        own = [i for i, s in enumerate(listed.spots) if (s.kind == "hot") == (feature.sign > 0)]
        away = {i: float(np.linalg.norm(np.array(listed.spots[i].position_m) - feature.position_m)) for i in own}
        i = min(away, key=lambda k: away[k], default=None)
        head = f"| {seed} | {'hot' if feature.sign > 0 else 'cold'} | {feature.size_px:g}"
        if i is None or away[i] > max(NEAR_M, feature.fwhm_m):
            yield f"{head} | not found | | | | |", None
            continue
        spot = listed.spots[i]
        area, off = spot.area_m2 / feature.area_m2 - 1, spot.extreme - feature.peak_c
        inside = spot.std is not None and abs(off) <= 1.96 * spot.std
        fine = away[i] <= NEAR_M and abs(area) <= AREA and abs(off) <= PEAK_C
        yield (
            f"{head} | {'yes' if fine else 'poorly'} | {100 * away[i]:.1f} | {area:+.0%} | {off:+.2f} ± {1.96 * (spot.std or 0):.2f} "
            f"{'' if inside else '(outside)'} | {spot.views} of {spot.seen_by} |",
            i,
        )


def other_rows(problem: Problem, listed: SpotList, taken: set[int], seed: int, folder: str) -> Iterator[tuple[str, bool]]:
    """A line for each other listed spot, and whether it is false."""
    for i, spot in enumerate(listed.spots):
        if i in taken:
            continue
        same, anything = true_excess(problem, spot, folder)
        cells = [f"{v:.1f}" if np.isfinite(v) else "–" for v in (same, anything)]
        x, y, z = spot.position_m
        which = "with" if folder == CLEAN else "without"
        cells = [str(seed), which, spot.kind, f"{x:.2f} {y:.2f} {z:.2f}", f"{abs(spot.excess):.1f}", *cells, f"{spot.views}"]
        yield f"| {' | '.join(cells)} |", max(same, anything) < LEAST_C


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="where captures and models are kept")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1])
    parser.add_argument("--size", type=int, default=400, help="side of all images, in pixels")
    parser.add_argument("--frames", type=int, default=50)
    parser.add_argument("--steps", type=int, help="of the RGB model; by default as many as `rtgs run` takes")
    args = parser.parse_args()
    spots, others, false = [], [], {CLEAN: 0, WITHOUT_FEATURES: 0}
    for seed in args.seeds:
        config = SynthConfig(
            scene="room", frames=args.frames, size=args.size, seed=seed, sfm_per_metre=2.0, features=("spots",), spots_each=1
        )
        problem = problem_of(args.out, config, args.steps)
        for which, folder in (("features", CLEAN), ("plain", WITHOUT_FEATURES)):
            scene = problem.photographed(which)
            listed = find_spots(scene, fit(problem, scene, {})[0])
            taken = set()
            if which == "features":
                for line, i in feature_rows(problem, listed, seed):
                    spots.append(line)
                    taken |= set() if i is None else {i}
            for line, is_false in other_rows(problem, listed, taken, seed, folder):
                others.append(line)
                false[folder] += is_false
    print("| seed | | px | found | off, cm | area | peak, °C | views |\n|---|---|---:|---|---:|---:|---|---|")
    print("\n".join(spots))
    heads = ["seed", "features", "", "where, m", "listed, °C", "true, same surface", "true, everything", "views"]
    print(f"\n| {' | '.join(heads)} |\n|---|---|---|---|" + "---:|" * 4)
    print("\n".join(others))
    print(f"\nfalse with features: {false[CLEAN]}; without: {false[WITHOUT_FEATURES]}")


if __name__ == "__main__":
    main()
