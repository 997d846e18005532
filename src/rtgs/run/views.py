"""Pictures, temperatures and depth from a run's models, pixel for pixel on top of each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal
from unicodedata import normalize

import numpy as np
import torch

from rtgs.base.errors import RtgsError
from rtgs.base.files import check_folder
from rtgs.base.progress import Progress
from rtgs.images.pictures import palette, save_png, save_tiff, to_picture, with_colour_bar
from rtgs.records.radiometry import PlanckRadiometry
from rtgs.records.scene import Scene
from rtgs.renderer import render
from rtgs.run.folder import RunFolder, refuse_own_folders


def render_views(
    folder: RunFolder,
    scene: Scene,
    out: Path,
    names: Sequence[str],
    *,
    viewpoint: Literal["rgb", "thermal"],
    emissivity: float | None = None,
    reflected_c: float | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Render both models from one camera of each frame.

    Writes for each name `NAME.rgb.png`, `NAME.thermal.png` (palette with a bar), `NAME.thermal.tiff` (float32, °C or counts) and
    `NAME.depth.tiff` (float32, along the optical axis, in metres, or in SfM units where nothing tells metres;
    NaN where the model covers less than half of the pixel).

    Args:
        names: frames; all registered ones when empty.
        viewpoint: whose camera to look through; both models are rendered there, so RGB, temperature and depth are aligned.
        emissivity, reflected_c: °C as they are under other object parameters than `rig.json`'s; nothing is fitted again.

    Raises:
        RtgsError: object parameters for a capture without Planck constants, or outside their limits; a name that is no registered frame; a
            run without a thermal model; an `out` that is the run or lies in the capture.
    """
    refuse_own_folders(folder, scene, out)
    check_folder(out)
    names = [normalize("NFC", name) for name in names]  # as frames are named
    unknown = sorted(set(names) - set(scene.world_from_rgb))
    if unknown:
        some = ", ".join(list(scene.world_from_rgb)[:3])
        raise RtgsError(f"render: frame {unknown[0]!r:.100} is not in the run; its frames are {some}, …")
    changes = {k: v for k, v in (("emissivity", emissivity), ("reflected_c", reflected_c)) if v is not None}
    radiometry = scene.capture.radiometry
    planck = radiometry if isinstance(radiometry, PlanckRadiometry) else None
    if changes and planck is None:
        raise RtgsError(
            f"render: {' and '.join(changes)} can be changed where rig.json has planck and object; this capture's temperatures are final."
        )
    if planck is not None:
        planck.reevaluated(np.zeros(1), **changes)  # limits, before any work
    rgb, thermal, scale = folder.read_rgb(), folder.read_thermal(), folder.read_scale()
    world_per_metre = scene.world_per_metre(1 / scale.unit_per_sfm)
    camera = scene.rig.rgb if viewpoint == "rgb" else scene.rig.thermal
    chosen = list(names) or [f.name for f in scene.frames]
    out.mkdir(parents=True, exist_ok=True)
    written = []
    for done, name in enumerate(chosen):
        pose = scene.rgb_from_world(name) if viewpoint == "rgb" else scene.thermal_from_world(name, scale.sfm_per_metre)
        temperature = thermal.render(camera, pose)
        lo, hi = thermal.range.lo, thermal.range.hi
        if changes and planck is not None:
            temperature = planck.reevaluated(temperature, **changes)
            lo, hi = (float(v) for v in planck.reevaluated(np.array([lo, hi]), **changes))
        save_png(out / f"{name}.rgb.png", to_picture(rgb.render(camera, pose)))
        save_png(out / f"{name}.thermal.png", with_colour_bar(palette(temperature, lo, hi), lo, hi, radiometry.unit))
        with torch.no_grad():
            view = render(rgb.gaussians, camera, pose, settings=replace(rgb.settings, with_depth=True))
        assert view.depth is not None
        alpha = view.alpha.numpy()
        with np.errstate(invalid="ignore", divide="ignore"):
            depth_m = np.where(alpha > 0.5, view.depth.numpy() / alpha / world_per_metre, np.nan)
        for kind, values in (("thermal", temperature), ("depth", depth_m)):
            path = out / f"{name}.{kind}.tiff"
            save_tiff(path, values.astype(np.float32))
            written.append(path)
        if progress is not None:
            progress(done + 1, len(chosen), name)
    return written
