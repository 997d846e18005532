"""Do origin and unit of the poses matter? One capture with its poses moved and in other units, each run from scratch.

    python benchmarks/world_frame.py --out DIR                            a synthetic room
    python benchmarks/world_frame.py --out DIR --captures CAPTURE ...     and captures with sparse/0 or transforms.json

Prints a Markdown table for each: scores on held-out views, the scale in units of the first row, and how far exported positions
(transforms.json and scene/) are from the given ones, in steps of float64 at the largest coordinate. The control `thermal_naive` is left
out: it takes one SfM unit for a metre, so it depends on the unit.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from rtgs.config import ExportConfig, RgbConfig, RunConfig, SynthConfig
from rtgs.io.colmap import quiet_colmap, read_sparse
from rtgs.io.image_files import frame_name
from rtgs.run.export import export
from rtgs.run.folder import RunFolder
from rtgs.run.pipeline import Pipeline
from rtgs.synthetic import write_capture

FAR = 1e7
CASES = ((0.0, 1.0), (FAR, 1.0), (0.0, 1e-4), (0.0, 1e4), (FAR, 1e4), (FAR, 1e-4))
DIRECTION = np.array([1.0, -0.6, 0.02])  # of the move, as UTM coordinates have it: two large numbers and a small one


def move_capture(capture: Path, out: Path, origin: float, unit: float, every: int = 1) -> None:
    """The same capture with every position p of its poses at unit · p + origin · `DIRECTION`; of its pairs, one in so many."""
    for name in ("rgb", "thermal"):
        (out / name).mkdir(parents=True)
        for file in sorted((capture / name).resolve().iterdir())[::every]:
            (out / name / file.name).symlink_to(file)
    shutil.copy(capture / "rig.json", out / "rig.json")
    shift = origin * DIRECTION
    if (capture / "sparse").is_dir():
        with quiet_colmap():
            model = pycolmap.Reconstruction(capture / "sparse" / "0")
            model.transform(pycolmap.Sim3d(unit, pycolmap.Rotation3d(), shift))
            (out / "sparse" / "0").mkdir(parents=True)
            model.write_binary(out / "sparse" / "0")
        return
    data = json.loads((capture / "transforms.json").read_text(encoding="utf-8"))
    for frame in data["frames"]:
        for row, along in zip(frame["transform_matrix"], shift, strict=False):
            row[3] = unit * row[3] + along
    (out / "transforms.json").write_text(json.dumps(data), encoding="utf-8")


def positions_of_transforms(path: Path) -> dict[str, NDArray[np.float64]]:
    """Camera position by frame name, as the file has it."""
    frames = json.loads(path.read_text(encoding="utf-8"))["frames"]
    return {frame_name(f["file_path"]): np.array(f["transform_matrix"])[:3, 3] for f in frames}


def given_positions(capture: Path) -> dict[str, NDArray[np.float64]]:
    """Camera position by frame name, as the capture gives it."""
    if not (capture / "sparse").is_dir():
        return positions_of_transforms(capture / "transforms.json")
    return positions_of_model(capture / "sparse" / "0")


def positions_of_model(folder: Path) -> dict[str, NDArray[np.float64]]:
    """Position of the RGB camera by frame name, in a COLMAP model."""
    return {name: pose.translation for name, pose in read_sparse(folder)[1].world_from_rgb.items()}


def resolutions_apart(found: dict[str, NDArray[np.float64]], given: dict[str, NDArray[np.float64]]) -> float:
    """Largest distance of two sets of positions, in steps of float64 at the largest coordinate."""
    step = max(float(np.spacing(np.abs(p)).max()) for p in given.values())
    return max(float(np.abs(found[name] - given[name]).max()) for name in found) / step


def run_case(capture: Path, folder: Path, origin: float, unit: float, config: RunConfig, every: int = 1) -> list[float]:
    """Move, run and export. Returns the row's numbers."""
    moved, run, exported = folder / "capture", folder / "run", folder / "export"
    if not moved.exists():
        move_capture(capture, moved, origin, unit, every)
    with Pipeline.start(moved, run, config) as pipeline:
        pipeline.run()
        shutil.rmtree(exported, ignore_errors=True)
        settings = ExportConfig(formats=("colmap", "nerfstudio"), frame="sfm")
        export(pipeline.folder, pipeline.folder.read_scene(pipeline.capture), exported, settings)
    scores, scale = json.loads((run / "metrics.json").read_text(encoding="utf-8")), RunFolder(run).read_scale()
    given = given_positions(moved)
    apart = [resolutions_apart(positions_of_transforms(exported / "nerfstudio" / "transforms.json"), given)]
    apart.append(resolutions_apart(positions_of_model(exported / "colmap" / "sparse" / "0"), given))
    rgb, thermal = scores["rgb"], scores["thermal"]
    error = thermal.get("mae_c", thermal.get("mae_counts"))
    half_width = 0.0 if scale.std_log is None else 1.96 * scale.std_log
    return [rgb["psnr"], rgb["ssim"], thermal["psnr"], thermal["ssim"], error, scale.sfm_per_metre / unit, half_width, *apart]


COLUMNS = ("RGB PSNR", "SSIM", "thermal PSNR", "SSIM", "MAE", "scale ÷ unit", "half its interval")


def table(name: str, capture: Path, out: Path, config: RunConfig, every: int = 1) -> None:
    """Print the rows of one capture."""
    print(
        f"| {name}: origin | unit | {' | '.join(COLUMNS)} | transforms.json | scene/ |\n|{'---:|' * (len(COLUMNS) + 4)}",
        flush=True,
    )
    first: list[float] = []
    for origin, unit in CASES:
        row = run_case(capture, out / name / f"{origin:g}-{unit:g}", origin, unit, config, every)
        first = first or row
        cells = [f"{a:.5g}{'' if f'{a:.3g}' == f'{b:.3g}' else ' *'}" for a, b in zip(row, first, strict=True)][: len(COLUMNS)]
        print(f"| {origin:g} | {unit:g} | {' | '.join(cells)} | {row[-2]:.1f} | {row[-1]:.1f} |", flush=True)
    print(flush=True)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--captures", type=Path, nargs="*", default=[])
    parser.add_argument("--every", type=int, default=1, help="use one in so many pairs of the captures")
    parser.add_argument("--steps", type=int, default=600, help="of the RGB model")
    parser.add_argument("--rgb-max-side", type=int, default=160)
    parser.add_argument("--size", type=int, default=160, help="of the room's images")
    parser.add_argument("--frames", type=int, default=32, help="of the room")
    o = parser.parse_args(argv)
    config = RunConfig(rgb_max_side=o.rgb_max_side, rgb=RgbConfig(quality="fast", steps=o.steps))
    room = o.out / "room" / "capture"
    write_capture(room, SynthConfig(scene="room", frames=o.frames, size=o.size, supersampling=1, thermal_clean=False))
    table("room", room, o.out, config)
    for capture in o.captures:
        table(capture.resolve().name, capture, o.out, config, o.every)
    print("`*`: differs from the first row in its first three digits. Last columns: in steps of float64.", flush=True)


if __name__ == "__main__":
    main()
