"""The undistorted photographs that belong to exported poses, as COLMAP models and nerfstudio's `transforms.json`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from rtgs.base.files import write_whole
from rtgs.base.progress import Progress
from rtgs.images.pictures import save_png, save_tiff, to_picture
from rtgs.io.colmap import write_scene
from rtgs.io.exports.frames import FileFrame
from rtgs.io.exports.subject import Subject
from rtgs.io.transforms import write_transforms


def write_colmap(folder: Path, subject: Subject, frame: FileFrame, progress: Progress | None) -> None:
    """Write `sparse/0`, both cameras as a rig, with the photographs in `images/rgb` and `images/thermal`, and temperatures in `celsius`.

    `folder` appears whole or not at all.
    """
    with write_whole(folder) as temporary:
        model = temporary / "sparse" / "0"
        write_scene(model, replace(subject.scene, given_from_world=frame.from_world), subject.baseline_unit(frame))
        (model / "failures.json").unlink()  # of a run folder, and no part of COLMAP's form
        _write_photographs(temporary, subject, progress)


def write_nerfstudio(folder: Path, subject: Subject, frame: FileFrame, progress: Progress | None) -> None:
    """Write `transforms.json` and `transforms_thermal.json` with the photographs that they name.

    `folder` appears whole or not at all.
    """
    scene = replace(subject.scene, given_from_world=frame.from_world)
    given, names = scene.as_given(), sorted(scene.world_from_rgb)
    thermal = {name: frame.from_world.carry(scene.world_from_thermal(name, subject.baseline_unit(frame))) for name in names}
    with write_whole(folder) as temporary:
        _write_photographs(temporary, subject, progress)
        files = {kind: {name: f"images/{kind}/{name}.png" for name in names} for kind in ("rgb", "thermal")}
        write_transforms(temporary / "transforms.json", scene.rig.rgb, given.world_from_rgb, files["rgb"])
        write_transforms(temporary / "transforms_thermal.json", scene.rig.thermal, thermal, files["thermal"])


def _write_photographs(folder: Path, subject: Subject, progress: Progress | None) -> None:
    """8-bit pictures, the thermal ones gray over the capture's range, and float32 temperatures beside them."""
    frames, span = subject.scene.frames, subject.thermal.range
    values = folder / ("celsius" if subject.thermal.unit == "°C" else "counts")
    for i, frame in enumerate(frames):
        save_png(folder / "images" / "rgb" / f"{frame.name}.png", to_picture(frame.rgb))
        temperature = np.asarray(frame.thermal, np.float32)
        save_png(folder / "images" / "thermal" / f"{frame.name}.png", to_picture(span.normalise(temperature)))
        save_tiff(values / f"{frame.name}.tiff", temperature)
        if progress is not None:
            progress(i + 1, len(frames), frame.name)
