"""What is drawn and written of single spots: crops of the photographs with a mark, and places for maps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from rtgs.base.json_records import to_json
from rtgs.images.pictures import Picture, palette, save_png, side_by_side, to_picture, with_colour_bar
from rtgs.records.camera import Camera
from rtgs.records.scene import Scene
from rtgs.records.spots import Spot, SpotList

CROP_PX = 320  # side of a crop in the file
LEAST_PX = 48  # thermal pixels to a side of a crop, at least
_ROOM = 6.0  # a crop is so many diameters wide
_MARK = (0, 255, 160)


def draw_crops(out: Path, scene: Scene, found: SpotList, sfm_per_metre: float, unit_per_sfm: float) -> None:
    """Write `NNN.png` for each spot: RGB and thermal image of the frame that shows it best, at one scale, with a ring around the spot.

    Args:
        sfm_per_metre: the scale of the model, for the thermal poses. unit_per_sfm: what the list's lengths rest on.
    """
    frames = {frame.name: frame for frame in scene.train_frames}
    given_from_world = scene.given_from_world
    for number, spot in enumerate(found.spots, start=1):
        name = spot.best_frames[0]
        place = given_from_world.apply_inverse(np.array(spot.position_m) / unit_per_sfm)
        radius = spot.diameter_m / 2 / unit_per_sfm / given_from_world.factor
        in_thermal, in_rgb = scene.thermal_from_world(name, sfm_per_metre).apply(place), scene.rgb_from_world(name).apply(place)
        thermal, rgb = scene.rig.thermal, scene.rig.rgb
        side = max(_ROOM * radius * 2 * thermal.fl_x / in_thermal[2], LEAST_PX) * in_thermal[2] / thermal.fl_x
        shown = frames[name].thermal
        part = _crop(shown.astype(np.float32), thermal, in_thermal, side)
        lo, hi = float(np.nanmin(part)), float(np.nanmax(part))
        lo, hi = (lo, hi) if hi > lo else (lo - 0.5, hi + 0.5)
        ring = max(1.5 * radius / side * CROP_PX, 10.0)
        right = with_colour_bar(_marked(palette(part, lo, hi), ring), lo, hi, found.unit if found.unit == "°C" else "")
        left = _marked(to_picture(_crop(frames[name].rgb, rgb, in_rgb, side)), ring)
        save_png(
            out / f"{number:03d}.png", side_by_side([left, right], [f"{number}: {name}", f"{spot.extreme:.1f} {found.unit}"])
        )


def _crop(image: NDArray[np.float32], camera: Camera, local: NDArray[np.float64], side: float) -> NDArray[np.float32]:
    """The square of a world's side around a place in camera axes, of `CROP_PX` pixels; NaN outside the image."""
    x, y = camera.project(local)
    half = 0.5 * side * camera.fl_x / local[2]
    steps = (np.arange(CROP_PX) + 0.5) / CROP_PX * 2 - 1
    columns, rows = (np.floor(c + half * steps).astype(int) for c in (x, y))
    inside = ((rows >= 0) & (rows < image.shape[0]))[:, None] & ((columns >= 0) & (columns < image.shape[1]))[None]
    part = image[np.clip(rows, 0, image.shape[0] - 1)[:, None], np.clip(columns, 0, image.shape[1] - 1)[None]].astype(np.float32)
    part[~inside] = np.nan
    return part


def _marked(picture: Picture, radius: float) -> Picture:
    image = Image.fromarray(picture)
    middle = CROP_PX / 2
    ImageDraw.Draw(image).ellipse([middle - radius, middle - radius, middle + radius, middle + radius], outline=_MARK, width=2)
    return np.asarray(image)


def geojson_of(found: SpotList) -> dict[str, Any]:
    """A feature collection of points. Coordinates are WGS 84 where the photographs tell where they were taken.

    Elsewhere they are metres (or SfM units) in the frame of the poses, and the member `coordinates` says so:
    maps would put them near the equator.
    """
    on_earth = all(spot.latitude_deg is not None for spot in found.spots)
    return {
        "type": "FeatureCollection",
        "coordinates": "longitude, latitude (degrees, WGS 84), altitude (m)"
        if on_earth
        else f"x, y, z in {'metres' if found.length_unit == 'm' else found.length_unit}, frame of the poses",
        "unit": found.unit,
        "criterion": found.criterion,
        "reference": None if found.reference is None else to_json(found.reference),
        "features": [_feature(number, spot, found, on_earth) for number, spot in enumerate(found.spots, start=1)],
    }


def _feature(number: int, spot: Spot, found: SpotList, on_earth: bool) -> dict[str, Any]:
    place = (spot.longitude_deg, spot.latitude_deg, spot.altitude_m) if on_earth else spot.position_m
    names = ("kind", "area_m2", "diameter_m", "extreme", "mean", "surroundings", "excess", "std", "views", "seen_by")
    properties = {"number": number, **{name: getattr(spot, name) for name in (*names, "modelled", "model_differs")}}
    properties["off_reference"] = found.off_reference(spot)
    return {"type": "Feature", "geometry": {"type": "Point", "coordinates": list(place)}, "properties": properties}
