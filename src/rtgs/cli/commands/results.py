"""`rtgs render`, `rtgs spots`, `rtgs export` and `rtgs share`: what leaves a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from rtgs.base.events import ResultLine, long_work
from rtgs.cli.options import Flat, Folder, Hidden
from rtgs.config import ExportConfig, SpotsConfig

_SHOWN = 20  # spots in the terminal; the files have all


def render_images(
    run: Folder,
    out: Path,
    listener: Hidden,
    frames: tuple[str, ...] = (),
    viewpoint: Literal["rgb", "thermal"] = "rgb",
    emissivity: float | None = None,
    reflected_c: float | None = None,
) -> None:
    """Render RGB, temperature and depth from the cameras of a run.

    Args:
        run: the run folder.
        out: folder for NAME.rgb.png, NAME.thermal.png, NAME.thermal.tiff (°C) and NAME.depth.tiff (metres, or SfM units).
        frames: names of frames; all when none is given.
        viewpoint: whose camera to look through; everything is rendered from there, so it is aligned.
        emissivity: temperatures as under this emissivity of the object instead of that in rig.json; nothing is fitted again.
        reflected_c: likewise, under another apparent temperature of what the object reflects.
    """
    from rtgs.run.folder import RunFolder
    from rtgs.run.views import render_views

    folder = RunFolder(run)
    scene = folder.load_scene(listener)
    with long_work(listener, "render", "views") as progress:
        render_views(
            folder,
            scene,
            out,
            frames,
            viewpoint=viewpoint,
            emissivity=emissivity,
            reflected_c=reflected_c,
            progress=progress,
        )
    listener(ResultLine(f"views: {out}"))


def spots(run: Folder, out: Path, config: Annotated[SpotsConfig, Flat], listener: Hidden) -> None:
    """List the hot and cold spots of a run: where they are, how large, how hot, and what the model shows there.

    Args:
        run: the run folder.
        out: folder for spots.csv, spots.json, spots.geojson, and a picture of each spot.
        config: what counts as a spot.
    """
    from rtgs.run.folder import RunFolder
    from rtgs.run.spots import list_spots, reference_line, spot_line

    folder = RunFolder(run)
    scene = folder.load_scene(listener)
    with long_work(listener, "spots", "views") as progress:
        found = list_spots(folder, scene, out, config, progress=progress)
    listener(ResultLine(f"spots: {len(found.spots)} ({found.criterion}), in {out}"))
    if found.reference is not None:
        listener(ResultLine(reference_line(found)))
    for number, spot in enumerate(found.spots[:_SHOWN], start=1):
        listener(ResultLine("  " + spot_line(number, spot, found)))


def export_models(run: Folder, out: Path, config: Annotated[ExportConfig, Flat], listener: Hidden) -> None:
    """Write models, points, poses with photographs, or orthophotos for other programs.

    Args:
        run: the run folder.
        out: folder for the files.
        config: formats, and the frame of the files.
    """
    from rtgs.run.export import export
    from rtgs.run.folder import RunFolder

    folder = RunFolder(run)
    export(folder, folder.load_scene(listener), out, config, listener)


def share(
    run: Folder,
    out: Path,
    listener: Hidden,
    title: str | None = None,
    spots: bool = True,
    most_gaussians: int = 200_000,
) -> None:
    """Write one page that shows the model in a browser: to send, and to open from disk.

    Args:
        run: the run folder.
        out: the page, a file that ends in .html.
        title: of the page; the run folder's name without it.
        spots: find the hot and cold spots, and list them.
        most_gaussians: of each model; 100,000 of both are 8 MB.
    """
    from rtgs.run.folder import RunFolder
    from rtgs.run.share.make import share as make

    folder = RunFolder(run)
    scene = folder.load_scene(listener)
    config = SpotsConfig() if spots else None
    make(folder, scene, out, title=title, spots=config, most=most_gaussians, listener=listener)
