"""`rtgs import` and `rtgs synth`: what makes a capture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from rtgs.base.events import ResultLine, long_work
from rtgs.cli.options import Flat, Folder, Hidden
from rtgs.config import SynthConfig
from rtgs.io.cameras.registry import MODULES as CAMERA_MODULES


def import_photographs(
    camera: tyro.conf.Positional[Literal[tuple(CAMERA_MODULES)]],  # type: ignore[valid-type]
    photographs: Folder,
    out: Path,
    listener: Hidden,
    rgb: Path | None = None,
    rig: Path | None = None,
) -> None:
    """Make a capture from a folder of radiometric JPEGs.

    Raw counts are kept with the camera's constants, so emissivity can still be changed: in the capture's rig.json.

    Args:
        camera: whose files they are.
        photographs: folder of radiometric JPEGs.
        out: the capture folder, new or empty.
        rgb: folder with visible pictures of the same names, for files that don't embed one.
        rig: a rig.json of this pair of cameras. Without one, what the files can't say is listed and has to be filled in.
    """
    from rtgs.io.cameras.import_folder import import_folder

    with long_work(listener, "import", f"import {camera}") as progress:
        result = import_folder(camera, photographs, out, rgb=rgb, rig=rig, progress=progress)
    listener(ResultLine(f"import: {result.frames} pairs in {out}"))
    for note in result.notes:
        listener(ResultLine(f"note: {note}"))
    if result.missing:
        listener(ResultLine(f"{out / 'rig.json'} is a start. Before `rtgs run`, fill in:"))
        for field in result.missing:
            listener(ResultLine(f"  {field}"))


def make_synthetic(out: Path, config: Annotated[SynthConfig, Flat], listener: Hidden) -> None:
    """Make a synthetic capture with known truth.

    Args:
        out: the capture folder.
        config: settings.
    """
    from rtgs.synthetic import write_capture

    with long_work(listener, "synth", f"synthetic {config.scene}") as progress:
        truth = write_capture(out, config, progress=lambda done, total: progress(done, total, ""))
    scale = f"{truth.sfm_per_metre:.6g} SfM units per metre"
    listener(ResultLine(f"synth: {config.frames} pairs in {out}, true scale {scale}"))
