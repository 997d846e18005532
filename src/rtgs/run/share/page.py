"""Writes the page: the models, the palettes, the spots, and the script that draws them."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.base.files import reason, write_text_whole
from rtgs.io.exports.frames import FileFrame
from rtgs.io.exports.subject import Subject, rgb_splats, temperature_columns, thermal_splats
from rtgs.maths.geometry import SE3
from rtgs.records.spots import Spot, SpotList
from rtgs.run.share.pack import Packed, pack

PALETTES = ("inferno", "turbo", "coolwarm", "gray")
MOST_GAUSSIANS = 200_000  # of each model: about 17 MB


def write_page(
    path: Path, subject: Subject, spots: SpotList | None, title: str, most: int = MOST_GAUSSIANS
) -> tuple[Packed, Packed]:
    """Write the page; `path` appears whole or not at all.

    Args:
        spots: the list for its sidebar; None: there is none.
        title: of the page.
        most: Gaussians of each model; the least visible of more are left out.

    Returns:
        What the page holds of the RGB model and of the thermal one.

    Raises:
        RtgsError: the page cannot be written.
    """
    frame = subject.frame("z-up", fixed=True)
    temperature = next(iter(temperature_columns(subject.thermal).values())).astype(np.float64)
    lo, hi = float(temperature.min()), float(temperature.max())
    hi = hi if hi > lo else lo + 1.0
    rgb = pack(rgb_splats(subject.rgb, frame.from_world), most, None)
    thermal = pack(thermal_splats(subject.thermal, frame.from_world, "gray"), most, (temperature - lo) / (hi - lo))
    data = {
        "title": title,
        "unit": subject.thermal.unit,
        "lengthUnit": frame.unit,
        "levels": [lo, hi],
        "range": [subject.thermal.range.lo, subject.thermal.range.hi],
        "background": [float(v) for v in subject.rgb.background],
        "rgb": rgb.json,
        "thermal": thermal.json,
        "palettes": {name: _palette(name) for name in PALETTES},
        "views": _views(subject, frame),
        "spots": [] if spots is None else [_spot(i, spot, subject, frame) for i, spot in enumerate(spots.spots, start=1)],
        "criterion": "" if spots is None else spots.criterion,
    }
    here = files("rtgs.run.share")
    page = (here / "page.html").read_text(encoding="utf-8")
    text = json.dumps(data, separators=(",", ":"), allow_nan=False, ensure_ascii=True)
    for mark, part in (
        ("{{title}}", html.escape(title)),
        ("{{style}}", (here / "page.css").read_text(encoding="utf-8")),
        ("{{drawing}}", (here / "splats.js").read_text(encoding="utf-8")),
        ("{{controls}}", (here / "page.js").read_text(encoding="utf-8")),
        ("{{data}}", text.replace("<", "\\u003c")),  # no text in it may end the script
    ):
        page = page.replace(mark, part)
    try:
        write_text_whole(path, page)
    except OSError as error:
        raise RtgsError(f"{path}: cannot be written: {reason(error)}") from error
    return rgb, thermal


def _palette(name: str) -> str:
    colours = matplotlib.colormaps[name](np.linspace(0, 1, 256))[:, :3]
    return base64.b64encode(np.rint(colours * 255).astype(np.uint8).tobytes()).decode("ascii")


def _views(subject: Subject, frame: FileFrame) -> list[dict[str, Any]]:
    """Where some of the photographs were taken from: the page begins at the first, and a jump looks from the nearest."""
    scene = subject.scene
    every = max(1, len(scene.frames) // 60)
    median = _median_distance(subject)
    found = []
    for photograph in scene.frames[::every]:
        pose: SE3 = frame.from_world.carry(scene.world_from_rgb[photograph.name])
        target = pose.translation + pose.rotation[:, 2] * median * frame.from_world.factor
        found.append(
            {
                "name": photograph.name,
                "eye": pose.translation.tolist(),
                "target": target.tolist(),
                "up": (-pose.rotation[:, 1]).tolist(),
            }
        )
    return found


def _median_distance(subject: Subject) -> float:
    """Of the Gaussians in front of the first camera, along its axis, world units."""
    scene = subject.scene
    pose = scene.rgb_from_world(scene.frames[0].name)
    depth = pose.apply(subject.rgb.gaussians.means.double().numpy())[:, 2]
    in_front = depth[depth > 0]
    return float(np.median(in_front)) if len(in_front) else 1.0


def _spot(number: int, spot: Spot, subject: Subject, frame: FileFrame) -> dict[str, Any]:
    given = np.array(spot.position_m) / subject.unit_per_sfm
    position: Sequence[float] = frame.of(subject.scene.given_from_world.apply_inverse(given)).tolist()
    return {
        "number": number,
        "kind": spot.kind,
        "position": position,
        "extreme": spot.extreme,
        "excess": spot.excess,
        "std": spot.std,
        "areaM2": spot.area_m2,
        "diameterM": spot.diameter_m,
        "views": spot.views,
        "frames": list(spot.best_frames),
        "modelDiffers": spot.model_differs,
        "modelled": spot.modelled,
    }
