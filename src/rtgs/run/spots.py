"""Lists the hot and cold spots of a run: `spots.csv`, `spots.json`, `spots.geojson`, and a picture of each."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from rtgs.base.csv_files import write_csv
from rtgs.base.files import check_folder, remove
from rtgs.base.json_records import write_json
from rtgs.base.progress import Progress
from rtgs.config import SpotsConfig
from rtgs.records.georeference import Georeference
from rtgs.records.scene import Scene
from rtgs.records.spots import Spot, SpotList
from rtgs.run.folder import RunFolder, refuse_own_folders
from rtgs.run.spot_files import draw_crops, geojson_of
from rtgs.thermal.spots import find_spots

COLUMNS = (
    *("number", "kind", "x_m", "y_m", "z_m", "area_m2", "diameter_m", "extreme", "mean", "surroundings", "excess", "std"),
    *("off_reference", "reference_name", "reference", "reference_std"),
    *("views", "seen_by", "modelled", "modelled_std", "model_differs", "best_frames"),
)
PLACE_COLUMNS = ("latitude_deg", "longitude_deg", "altitude_m")


def list_spots(folder: RunFolder, scene: Scene, out: Path, config: SpotsConfig, *, progress: Progress | None = None) -> SpotList:
    """Find the spots of the run and write them to the folder `out`.

    Raises:
        RtgsError: `out` is the run or lies in the capture, or the thermal model is missing.
    """
    refuse_own_folders(folder, scene, out)
    check_folder(out)
    scale, place = folder.read_scale(), folder.read_georeference()
    model = folder.read_thermal()
    found = find_spots(scene, model, config, unit_per_sfm=scale.unit_per_sfm, length_unit=scale.length_unit, progress=progress)
    if place is not None:
        found = replace(found, spots=tuple(on_the_earth(spot, place, scale.unit_per_sfm) for spot in found.spots))
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "spots.json", found)
    columns = columns_of(found) if place is None else (*columns_of(found), *PLACE_COLUMNS)
    write_csv(out / "spots.csv", columns, [row_of(i + 1, spot, found) for i, spot in enumerate(found.spots)])
    write_json(out / "spots.geojson", geojson_of(found))
    pictures = out / "spots"
    pictures.mkdir(exist_ok=True)
    for old in pictures.glob("[0-9][0-9][0-9].png"):  # of a list with more spots
        remove(old)
    draw_crops(pictures, scene, found, model.sfm_per_metre, scale.unit_per_sfm)
    return found


def on_the_earth(spot: Spot, place: Georeference, metres_per_sfm: float) -> Spot:
    """The spot with its latitude, longitude and altitude."""
    latitude, longitude, altitude = place.places(np.array(spot.position_m) / metres_per_sfm).tolist()
    return replace(spot, latitude_deg=latitude, longitude_deg=longitude, altitude_m=altitude)


def columns_of(found: SpotList) -> tuple[str, ...]:
    """The names of the columns; "x_m" is "x_sfm" where nothing tells metres."""
    return COLUMNS if found.length_unit == "m" else tuple(re.sub(r"_m(2?)$", r"_sfm\1", name) for name in COLUMNS)


def spot_line(number: int, spot: Spot, found: SpotList) -> str:
    """A spot in a line of text."""
    unit, length_unit, off = found.unit, found.length_unit, found.off_reference(spot)
    x, y, z = spot.position_m
    against = "" if off is None else f", {off:+.1f} to the reference"
    line = (
        f"{number}: {spot.kind}, {spot.extreme:.1f} {unit} ({spot.excess:+.1f}{against}) at {x:.3f} {y:.3f} {z:.3f} {length_unit}"
    )
    area = f"{1e4 * spot.area_m2:.3g} cm²" if length_unit == "m" else f"{spot.area_m2:.3g} square SfM units"
    line += f", {area}, {spot.views} views, best {spot.best_frames[0]}"
    if spot.model_differs:
        line += f"; the model shows {spot.modelled:.1f} {unit}"
    return line


def reference_line(found: SpotList) -> str:
    """What spots are compared with, in a line of text; "" where they are not."""
    reference = found.reference
    if reference is None:
        return ""
    line = f"reference{f' {reference.name}' if reference.name else ''}: {reference.temperature:.2f}"
    if reference.std is not None:
        line += f" ± {reference.std:.2f}"
    seen = f", {reference.views} {'view' if reference.views == 1 else 'views'}" if reference.views else ""
    return f"{line} {found.unit}{seen}"


def row_of(number: int, spot: Spot, found: SpotList) -> list[str]:
    """The cells of a spot, one for each of `COLUMNS`, and of `PLACE_COLUMNS` where its place is known."""

    def text(value: float | None) -> str:
        return "" if value is None else f"{value:.6g}"

    reference = found.reference
    return [
        str(number),
        spot.kind,
        *(f"{v:.4f}" for v in spot.position_m),
        *(text(v) for v in (spot.area_m2, spot.diameter_m, spot.extreme, spot.mean, spot.surroundings, spot.excess, spot.std)),
        text(found.off_reference(spot)),
        *(["", "", ""] if reference is None else [reference.name, text(reference.temperature), text(reference.std)]),
        str(spot.views),
        str(spot.seen_by),
        text(spot.modelled),
        text(spot.modelled_std),
        "yes" if spot.model_differs else "no",
        " ".join(spot.best_frames),
        *(
            []
            if spot.latitude_deg is None
            else [f"{spot.latitude_deg:.9f}", f"{spot.longitude_deg:.9f}", f"{spot.altitude_m:.3f}"]
        ),
    ]
