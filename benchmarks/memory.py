"""Peak memory of loading captures and of whole runs, and how much of it a pair of photographs takes.

    python benchmarks/memory.py --out DIR [--only load photographs run demo capture] [--capture arco] [--pairs 1000]

Each row is a process of its own; its peak is the resident memory that the system reports when it ends, children included. Captures are a
flat wall that a camera moves along: every picture is a piece of one texture, so that a thousand pairs with exact poses and points are
made in a minute. What DIR holds already is used again (captures), or goes on (runs). Runs have short settings, since memory is reached in
the first steps of each stage.

| row | what is done |
|---|---|
| load | `load_capture` of 100 and 300 pairs at 96 × 54 and 64 × 52, then of --pairs at 960 × 540 and 640 × 512; each image is used once |
| photographs | the same for 300 pairs with JPEGs of 12 megapixels |
| run | `rtgs run` of the --pairs, with few steps |
| demo | `rtgs demo` |
| capture | `rtgs run` of a capture of your own, with the defaults |
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from PIL import Image

from rtgs.io.colmap import colmap_camera, quiet_colmap, rigid3d_from_se3
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera

BASELINE_M, DISTANCE_M = 0.2, 4.0
THERMAL_FOCAL = 0.75  # of the RGB camera's
STEP_PX = 8  # of an RGB picture 960 pixels wide, from one position to the next: 6 in the thermal one
COLUMNS = 40  # positions in a row
LOAD = """
import sys
from rtgs.io.capture import load_capture
capture = load_capture(sys.argv[1], cache_bytes=int(sys.argv[2]) if len(sys.argv) > 2 else None)
for frame in capture.frames:
    frame.rgb.sum(), frame.thermal.sum()
"""
STARTER = """
import os, sys
quiet = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0)]
child = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ, file_actions=quiet)
_, status, used = os.wait4(child, 0)
print(used.ru_maxrss, used.ru_utime + used.ru_stime)
sys.exit(status != 0)
"""
SHORT = ["--rgb.steps", "200", "--rgb.densify.max-gaussians", "30000", "--scale.max-frames", "16"]


@dataclass(frozen=True)
class Peak:
    """What a process took: bytes, and seconds of wall and of processor time."""

    peak: int
    wall: float
    processor: float

    @staticmethod
    def of(command: list[str]) -> Peak:
        """Run a command to its end.

        A new process counts the memory of the one that starts it until it has its own, so a small one starts it.
        """
        start = time.perf_counter()
        starter = subprocess.run([sys.executable, "-S", "-c", STARTER, *command], stdout=subprocess.PIPE, check=False)
        if starter.returncode:
            raise SystemExit(f"{' '.join(command)} failed; its message is above.")
        peak, processor = starter.stdout.split()
        unit = 1 if sys.platform == "darwin" else 1024
        return Peak(unit * int(peak), time.perf_counter() - start, float(processor))


def make_wall(
    root: Path, pairs: int, size: tuple[int, int], thermal: tuple[int, int], step_px: int = STEP_PX, enlarge: int = 1
) -> None:
    """A capture of a wall, with poses and points.

    Args:
        size, thermal: width and height of the pictures.
        step_px: how far the RGB picture moves from one position to the next; a multiple of 4.
        enlarge: the stored JPEGs are so many times larger.
    """
    if (root / "rig.json").exists():
        return
    for folder in ("rgb", "thermal", "sparse/0"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    focal = 0.8333 * size[0] * enlarge
    focal = STEP_PX * round(focal / STEP_PX) / enlarge
    rows = -(-pairs // COLUMNS)
    offset = round(BASELINE_M * focal * THERMAL_FOCAL / DISTANCE_M)  # of the thermal picture, by the baseline
    baseline = offset * DISTANCE_M / (focal * THERMAL_FOCAL)
    width = size[0] + step_px * COLUMNS + 2 * offset
    texture = _texture(max(width, round((thermal[0] + offset) / THERMAL_FOCAL) + step_px * COLUMNS), size[1] * 2 + step_px * rows)
    heat = cv2.resize(texture.mean(axis=2), None, fx=THERMAL_FOCAL, fy=THERMAL_FOCAL, interpolation=cv2.INTER_AREA)
    rng, noise = np.random.default_rng(1), 3.0
    poses: dict[str, SE3] = {}
    for i in range(pairs):
        name, (column, row) = f"{i:05d}", (i % COLUMNS, i // COLUMNS)
        x, y = step_px * column, step_px * row
        picture: np.ndarray = texture[y : y + size[1], x : x + size[0]].astype(np.uint8)
        if enlarge > 1:
            picture = cv2.resize(picture, None, fx=enlarge, fy=enlarge, interpolation=cv2.INTER_CUBIC)
        if enlarge == 1 or i < 4:
            Image.fromarray(picture).save(root / "rgb" / f"{name}.jpg", quality=90)
        else:  # what a picture shows is of no importance to loading
            os.link(root / "rgb" / f"{i % 4:05d}.jpg", root / "rgb" / f"{name}.jpg")
        tx, ty = 3 * x // 4 + offset, 3 * y // 4
        counts = 4000 + 4 * heat[ty : ty + thermal[1], tx : tx + thermal[0]] + rng.normal(0, noise, thermal[::-1])
        Image.fromarray(counts.round().astype(np.uint16)).save(root / "thermal" / f"{name}.png", compress_level=1)
        poses[name] = SE3(np.eye(3), np.array([x, y, 0.0]) * DISTANCE_M / focal)
    rgb = Camera("PINHOLE", *(enlarge * n for n in size), *(2 * [enlarge * focal]), *(enlarge * n / 2 for n in size))
    # Both pictures begin at the same corner of the wall, but for the baseline.
    seen = Camera("PINHOLE", *thermal, *(2 * [focal * THERMAL_FOCAL]), *(THERMAL_FOCAL * n / 2 for n in size))
    _write_poses(root, rgb, poses, texture, focal, size)
    rig = {
        "rgb": {k: getattr(rgb, k) for k in ("model", "width", "height", "fl_x", "fl_y", "cx", "cy")},
        "thermal": {k: getattr(seen, k) for k in ("model", "width", "height", "fl_x", "fl_y", "cx", "cy")}
        | {"celsius_per_count": 0.025, "celsius_offset": -100.0},
        "rgb_from_thermal": SE3(np.eye(3), np.array([baseline, 0.0, 0.0])).matrix().tolist(),
    }
    (root / "rig.json").write_text(json.dumps(rig), encoding="utf-8")


def _texture(width: int, height: int) -> np.ndarray:
    """`[height, width, 3]` in 0 … 255: spots of many sizes."""
    rng, out = np.random.default_rng(0), np.zeros((height, width, 3), np.float32)
    for cell in (4, 12, 40, 130):
        small = rng.normal(0, 1, (height // cell + 2, width // cell + 2, 3)).astype(np.float32)
        out += cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(128 + 30 * out).clip(0, 255)


def _write_poses(
    root: Path, camera: Camera, poses: dict[str, SE3], texture: np.ndarray, focal: float, size: tuple[int, int]
) -> None:
    model, rng = pycolmap.Reconstruction(), np.random.default_rng(2)
    model.add_camera_with_trivial_rig(colmap_camera(camera, 1))
    for i, (name, pose) in enumerate(poses.items()):
        image = pycolmap.Image(name=f"{name}.jpg", camera_id=1, image_id=i + 1)
        model.add_image_with_trivial_frame(image, rigid3d_from_se3(pose.inverse()))
    for _ in range(5000):
        v, u = (int(rng.integers(n)) for n in texture.shape[:2])
        place = np.array([u + 0.5 - size[0] / 2, v + 0.5 - size[1] / 2, focal]) * DISTANCE_M / focal
        model.add_point3D(place, pycolmap.Track(), texture[v, u].astype(np.uint8))
    with quiet_colmap():
        model.write_binary(root / "sparse" / "0")


def load(capture: Path, cache_bytes: int | None = None) -> Peak:
    """Load a capture and use each of its images once.

    Args:
        cache_bytes: memory for images; None: the default.
    """
    return Peak.of([sys.executable, "-c", LOAD, str(capture), *([] if cache_bytes is None else [str(cache_bytes)])])


def rtgs(*arguments: str) -> Peak:
    return Peak.of([sys.executable, "-m", "rtgs", *arguments])


def main() -> None:
    kinds = ("load", "photographs", "run", "demo", "capture")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for captures and runs; some GB")
    parser.add_argument("--only", nargs="+", choices=kinds, default=kinds)
    parser.add_argument("--pairs", type=int, default=1000)
    parser.add_argument("--capture", type=Path, help="a capture of your own")
    o = parser.parse_args()
    small = [o.out / f"small-{n}" for n in (100, 300)]
    many, large = o.out / f"wall-{o.pairs}", o.out / "large-300"
    print("| what | GB | seconds | of a processor |\n|---|---:|---:|---:|")

    def show(what: str, found: Peak) -> Peak:
        print(f"| {what} | {found.peak / 1e9:.2f} | {found.wall:.0f} | {found.processor:.0f} |", flush=True)
        return found

    if "load" in o.only:
        peaks = []
        for root, count in zip(small, (100, 300), strict=True):
            make_wall(root, count, (96, 54), (64, 52), step_px=4)
            peaks.append(show(f"load {count} pairs, 96 × 54 and 64 × 52, 1 MB for images", load(root, 10**6)).peak)
        print(f"| growth a pair without images: {(peaks[1] - peaks[0]) / 200 / 1e3:,.0f} kB | | | |")
        make_wall(many, o.pairs, (960, 540), (640, 512))
        show(f"load {o.pairs:,} pairs, 960 × 540 and 640 × 512", load(many))
    if "photographs" in o.only:
        make_wall(large, 300, (1000, 750), (640, 512), enlarge=4)
        show("load 300 pairs, 4000 × 3000 and 640 × 512", load(large))
    if "run" in o.only:
        make_wall(many, o.pairs, (960, 540), (640, 512))
        show(
            f"run {o.pairs:,} pairs, 960 × 540 and 640 × 512, 200 steps",
            rtgs("run", str(many), "--out", str(many) + "-run", *SHORT),
        )
    if "demo" in o.only:
        show("rtgs demo", rtgs("demo", "--out", str(o.out / "demo")))
    if "capture" in o.only and o.capture is not None:
        show(f"run {o.capture.name}", rtgs("run", str(o.capture), "--out", str(o.out / "own")))


if __name__ == "__main__":
    main()
