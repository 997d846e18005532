"""Make the pictures of the tutorial from a finished demo: `python docs/make_tutorial_pictures.py rtgs-demo [VIEWS]`.

VIEWS is the folder of `rtgs render rtgs-demo/run --out VIEWS --frames frame_008`. One screenshot is taken by hand:
`docs/images/tutorial_report.jpg`, the top of the report in a window 540 pixels wide.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from rtgs.images.pictures import palette, side_by_side, with_colour_bar
from rtgs.io.capture import load_capture

IMAGES = Path(__file__).parent / "images"
FRAME = "frame_008"


def picture(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"))


def row(name: str, pictures: list[np.ndarray], labels: list[str]) -> None:
    """Side by side, at one height."""
    height = min(p.shape[0] for p in pictures)
    sized = [np.asarray(Image.fromarray(p).resize((round(p.shape[1] * height / p.shape[0]), height))) for p in pictures]
    Image.fromarray(side_by_side(sized, labels)).save(IMAGES / f"{name}.jpg", quality=88, optimize=True)


def main(demo: Path, views: Path | None) -> None:
    frame = next(f for f in load_capture(demo / "capture").frames if f.name == FRAME)
    lo, hi = np.percentile(frame.thermal, [0.5, 99.9])
    thermal = with_colour_bar(palette(frame.thermal, lo, hi), float(lo), float(hi))
    renders = demo / "run" / "renders"
    row("tutorial_pair", [picture(demo / "capture" / "rgb" / f"{FRAME}.png"), thermal], ["rgb", "thermal"])
    overlays = [picture(renders / "overlay" / f"{FRAME}.{when}.png") for when in ("before", "after")]
    row("tutorial_edges", overlays, ["scale ignored", "scale found"])
    names = ["reference", "render", "error"]
    row("tutorial_thermal", [picture(renders / "thermal" / f"{FRAME}.{n}.png") for n in names], names)
    if views is not None:
        files = [views / f"{FRAME}.rgb.png", views / f"{FRAME}.thermal.png"]
        row("tutorial_views", [picture(f) for f in files], ["RGB", "temperature"])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)
