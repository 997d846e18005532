"""`rtgs share`: the page of a run."""

from __future__ import annotations

from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.events import Listener, ResultLine, WarningLine, long_work, nobody
from rtgs.config import ExportConfig, SpotsConfig
from rtgs.records.scene import Scene
from rtgs.run.export import subject_of
from rtgs.run.folder import RunFolder, refuse_own_folders
from rtgs.run.share.page import MOST_GAUSSIANS, write_page
from rtgs.thermal.spots import find_spots


def share(
    folder: RunFolder,
    scene: Scene,
    out: Path,
    *,
    title: str | None = None,
    spots: SpotsConfig | None = None,
    most: int = MOST_GAUSSIANS,
    listener: Listener = nobody,
) -> Path:
    """Write a run's models, palettes and spots as one page that needs no server and fetches nothing.

    Args:
        out: a file whose name ends in `.html`; its folder is made.
        title: None: the name of the run's folder.
        spots: what counts as a spot; None: the page has no list.
        most: Gaussians of each model.

    Raises:
        RtgsError: another name, a place in the capture, a stage is missing, or the page cannot be written.
    """
    if out.suffix.lower() not in (".html", ".htm") or out.is_dir():
        raise RtgsError(f"--out {out}: name a file that ends in .html.")
    if most < 1:
        raise RtgsError(f"--most-gaussians {most}: at least 1.")
    refuse_own_folders(folder, scene, out)
    scale = folder.read_scale()
    subject = subject_of(folder, scene, ExportConfig())
    found = None
    if spots is not None:
        with long_work(listener, "spots", "spots") as progress:
            found = find_spots(
                scene, subject.thermal, spots, unit_per_sfm=scale.unit_per_sfm, length_unit=scale.length_unit, progress=progress
            )
    out.parent.mkdir(parents=True, exist_ok=True)
    packed = write_page(out, subject, found, title or folder.path.resolve().name, most)
    listener(ResultLine(f"wrote {out}: {out.stat().st_size / 1e6:.1f} MB, opens in a browser without a server"))
    for model, name in zip(packed, ("colour", "temperature"), strict=True):
        if model.left_out:
            listener(
                WarningLine(
                    f"{name}: {model.left_out:,} of the Gaussians, those that cover least, are left out (--most-gaussians)"
                )
            )
    if scale.no_metres:
        listener(WarningLine(scale.no_metres))
    if scale.doubt:
        listener(WarningLine(f"lengths on the page may not be metres: {scale.doubt}"))
    return out
