"""How well a board calibrates a rig whose truth is known, and whether the truth lies in the intervals.

    python benchmarks/calibrate_target.py [--trials 50] [--pairs 20] [--noise 0.2]

Each trial draws a rig, poses of a board of 9×6 inner corners that fill the image, and noise of the corners. Prints a Markdown table.
"""

from __future__ import annotations

import argparse

import numpy as np

from rtgs.calibration.boards import make_board
from rtgs.calibration.lens import View, camera, moved, project
from rtgs.calibration.solve import Pair, solve
from rtgs.calibration.summary import results, rig_of
from rtgs.config import BoardConfig
from rtgs.maths.geometry import SE3, axis_angle_from_rotation, rotation_from_axis_angle

SIZES = (1280, 960), (640, 512)
BOARD = BoardConfig("9x6", 0.05)


def draw_pairs(
    rng: np.random.Generator, rgb: np.ndarray, thermal: np.ndarray, rig: np.ndarray, n: int, noise: float
) -> list[Pair]:
    """Pairs in which both cameras see the whole board. rig: `[6]`, thermal from RGB."""
    board, pairs = make_board(BOARD), list[Pair]()
    middle = board.points.mean(axis=0)
    while len(pairs) < n:
        tilt = rng.uniform(25, 50) * np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a), 0.0])
        turn = rotation_from_axis_angle(np.radians(tilt)) @ rotation_from_axis_angle([0, 0, rng.uniform(-0.5, 0.5)])
        z = rng.uniform(0.45, 0.8)
        place = np.array([rng.uniform(-0.35, 0.35) * z, rng.uniform(-0.3, 0.3) * z, z])
        seen, _ = moved(np.concatenate([axis_angle_from_rotation(turn), place - turn @ middle]), board.points)
        at = [project(rgb, seen)[0], project(thermal, moved(rig, seen)[0])[0]]
        if all((p > 4).all() and (p < np.array(s) - 4).all() for p, s in zip(at, SIZES, strict=True)):
            views = [View(board.points, p + rng.normal(0, noise, p.shape)) for p in at]
            pairs.append(Pair(f"pair{len(pairs):02d}", views[0], views[1], board.orders))
    return pairs


def draw_truth(rng: np.random.Generator, distorted: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """RGB and thermal values `[8]`, and the rig `[6]`, thermal from RGB."""
    lens = rng.uniform([-0.15, 0.02, -0.002, -0.002], [-0.05, 0.1, 0.002, 0.002]) if distorted else np.zeros(4)
    hot = rng.uniform([-0.4, 0.1, -0.002, -0.002], [-0.2, 0.3, 0.002, 0.002]) if distorted else np.zeros(4)
    f, g = rng.uniform(950, 1100), rng.uniform(480, 560)
    rgb = np.array([f, f, 640 + rng.normal(0, 8), 480 + rng.normal(0, 8), *lens])
    thermal = np.array([g, g, 320 + rng.normal(0, 5), 256 + rng.normal(0, 5), *hot])
    return rgb, thermal, np.concatenate([rng.normal(0, 0.03, 3), [-rng.uniform(0.08, 0.15), *rng.normal(0, 0.01, 2)]])


def trial(seed: int, pairs: int, noise: float) -> tuple[dict[str, float], list[bool], bool]:
    """Errors of one trial; whether each number's truth lies within 1.96 standard deviations; whether the pairs agree."""
    rng = np.random.default_rng(seed)
    rgb, thermal, rig = draw_truth(rng, distorted=seed % 2 == 1)
    seen = draw_pairs(rng, rgb, thermal, rig, pairs, noise)
    found = solve(seen, *SIZES, lambda *_: None)
    got = rig_of(found, *SIZES)
    ids = np.arange(len(make_board(BOARD).points))
    table = results(BOARD, found, got, {}, [(ids, ids)] * len(found.names))
    truth = SE3(rotation_from_axis_angle(rig[:3]), rig[3:]).inverse()
    length = float(np.linalg.norm(truth.translation))
    turn = np.degrees(np.linalg.norm(axis_angle_from_rotation(got.rgb_from_thermal.rotation @ truth.rotation.T)))
    errors = {
        "focal RGB, %": 100 * abs(got.rgb.fl_x / rgb[0] - 1),
        "focal thermal, %": 100 * abs(got.thermal.fl_x / thermal[0] - 1),
        "rotation, °": float(turn),
        "baseline, %": 100 * abs(got.baseline_m / length - 1),
    }
    inside = []
    for values, result in ((rgb, table.rgb), (thermal, table.thermal)):
        true = camera("OPENCV", SIZES[0], values)
        inside += [bool(abs(v.value - getattr(true, v.name)) <= 1.96 * v.std) for v in result.values]
    pose = [*np.degrees(axis_angle_from_rotation(truth.rotation)), *(1000 * truth.translation), 1000 * length]
    inside += [bool(abs(v.value - t) <= 1.96 * v.std) for v, t in zip(table.rig, pose, strict=True)]
    return errors, inside, found.agree


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--noise", type=float, default=0.2)
    o = parser.parse_args()
    done = [trial(seed, o.pairs, o.noise) for seed in range(o.trials)]
    print("| error | median | 90th percentile | worst |\n|---|---|---|---|")
    for name in done[0][0]:
        values = [errors[name] for errors, _, _ in done]
        print(f"| {name} | {np.median(values):.3f} | {np.percentile(values, 90):.3f} | {max(values):.3f} |")
    inside = [x for _, row, _ in done for x in row]
    agreeing = sum(agree for *_, agree in done)
    print(
        f"\nTruth within 95 % intervals: {np.mean(inside):.1%} of {len(inside)} numbers; pairs agree in {agreeing} of {len(done)}."
    )


if __name__ == "__main__":
    main()
