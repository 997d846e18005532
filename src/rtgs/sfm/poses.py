"""Capture → Scene: RGB poses and sparse points.

Poses that came with the capture are kept. Where they have no points, points are triangulated with the poses held fixed; where
there are no poses, COLMAP's incremental mapper finds both, with the calibrated intrinsics held fixed.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.files import room, room_in
from rtgs.base.progress import Progress
from rtgs.config import SfmConfig
from rtgs.io.image_files import list_images, read_header, write_upright
from rtgs.maths.geometry import SE3
from rtgs.records.capture import NO_POINTS, Capture, SparsePoints
from rtgs.records.scene import Scene
from rtgs.sfm.colmap_job import Task, matched_pairs
from rtgs.sfm.colmap_process import do_apart


def run_sfm(
    capture: Capture, config: SfmConfig | None = None, *, work_dir: Path | None = None, progress: Progress | None = None
) -> Scene:
    """Give a capture its RGB poses and points.

    Args:
        capture: its image files are read again where features are needed; nothing is written to its folder.
        config: settings.
        work_dir: where COLMAP's database goes, for those who want to look at it; a temporary folder otherwise.
        progress: called in this thread with done, total and a step: "features", "matching", "mapping" or "triangulation". An
            exception from it (or Ctrl-C) ends COLMAP's work and is raised here.

    Returns:
        The scene, in a world that is recentred and scaled: `Scene.given_from_world` leads back to the frame of the capture's poses or of
        COLMAP. `failures` says why each missing frame is missing; a triangulation without a point adds a warning to the
        capture.

    Raises:
        RtgsError: an image file has gone, the disk has too little room for COLMAP's database, or fewer than three frames could be
            registered.
    """
    config = config or SfmConfig()
    report = progress or (lambda done, total, stage: None)
    if capture.poses is not None and capture.poses.points is not None and len(capture.poses.points) > 0:
        return _scene_from_poses(capture, capture.poses.world_from_rgb, capture.poses.points).recentred()
    if work_dir is not None:
        work_dir.mkdir(parents=True, exist_ok=True)
        return _run_colmap(capture, config, work_dir, report)
    with tempfile.TemporaryDirectory(prefix="rtgs-sfm-") as folder:
        return _run_colmap(capture, config, Path(folder), report)


def _scene_from_poses(capture: Capture, world_from_rgb: Mapping[str, SE3], points: SparsePoints) -> Scene:
    failures = {frame.name: "no pose came with the capture" for frame in capture.frames if frame.name not in world_from_rgb}
    return Scene(capture, dict(world_from_rgb), points, failures)


def _run_colmap(capture: Capture, config: SfmConfig, work_dir: Path, report: Progress) -> Scene:
    names = [frame.name for frame in capture.frames]
    if capture.poses is not None:
        names = [name for name in names if name in capture.poses.world_from_rgb]
    _check_space(work_dir, len(names), config)
    poses = capture.poses
    # Points are triangulated in the world: far from the origin, COLMAP's float64 runs short of digits too.
    posed = None if poses is None else _scene_from_poses(capture, poses.world_from_rgb, NO_POINTS).recentred()
    given = None if posed is None else posed.steady().world_from_rgb
    files = _upright_files(capture, names, work_dir)
    start = capture.rgb_start if posed is None else None
    found = do_apart(Task(capture.root, capture.raw_rig.rgb, config, work_dir, *files, given, start), report)
    if found.rgb is not None:
        capture = capture.with_found_rgb(found.rgb)
    if posed is None:
        return Scene(capture, found.world_from_rgb, found.points, found.failures).recentred()
    if len(found.points) == 0:
        said = (
            "No point could be triangulated from the poses that came with the capture; the RGB model starts from random points."
        )
        capture = replace(capture, warnings=(*capture.warnings, said))
    return replace(posed, capture=capture, points=found.points)


def _check_space(work_dir: Path, frames: int, config: SfmConfig) -> None:
    """Refuse where COLMAP's database may not fit, before any work.

    An image has at most `max_features` features of 128 + 24 bytes. A pair is taken to match a quarter of them, before and after
    geometric verification, with 8 bytes each. SQLite keeps changes in a second file of up to the same size.
    """
    pairs = matched_pairs(frames, config)
    needed = 2 * (frames * config.max_features * 152 + pairs * config.max_features * 4) + (1 << 20)
    if room(work_dir) < needed:
        raise RtgsError(
            f"{work_dir}: structure from motion may need {needed / 1e6:,.0f} MB there. {room_in(work_dir)}. Make room, choose another "
            "place for the run, or lower --sfm.max-features."
        )


def _upright_files(capture: Capture, names: Iterable[str], work_dir: Path) -> tuple[Path, dict[str, str]]:
    """The folder COLMAP reads, and the file names in it by frame name.

    COLMAP reads the stored pixels. Where the capture's cameras are those of upright images and a file has an orientation tag, upright
    copies are written into the work folder.
    """
    files = list_images(capture.root / "rgb")
    missing = [name for name in names if name not in files]
    if missing:
        raise RtgsError(
            f"{capture.root / 'rgb'}: the image of frame {missing[0]!r} has gone. Put it back, or load the capture again."
        )
    files = {name: files[name] for name in names}
    if not capture.rgb_upright or all(read_header(path).orientation == 1 for path in files.values()):
        return capture.root / "rgb", {name: path.name for name, path in files.items()}
    copies = work_dir / "upright"
    copies.mkdir(exist_ok=True)
    for name, path in files.items():
        write_upright(path, copies / f"{name}.png")
    return copies, {name: f"{name}.png" for name in files}
