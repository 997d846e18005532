"""Make the pictures of the documents: `python docs/make_pictures.py [RUN]`.

Writes `docs/images/scenes.jpg`, and from a finished run (such as `rtgs-demo/run`) `docs/images/edges.jpg`.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from rtgs.images.pictures import palette, side_by_side, to_picture
from rtgs.io.capture import load_capture
from rtgs.synthetic import SCENES, SynthConfig, write_capture

SIZE = 224
FRAME = {"room": 4}


IMAGES = Path(__file__).parent / "images"


def edges(run: Path) -> None:
    """Thermal edges on the gray render of the RGB model, before and after, and the thermal render, of one held-out frame."""
    name = sorted(p.name.removesuffix(".after.png") for p in (run / "renders" / "overlay").glob("*.after.png"))[-1]
    files = [
        f"overlay/{name}.before.png",
        f"overlay/{name}.after.png",
        f"thermal/{name}.reference.png",
        f"thermal/{name}.render.png",
    ]
    pictures = [np.asarray(Image.open(run / "renders" / f).convert("RGB")) for f in files]
    labels = ["scale ignored", "scale found", "thermal image (held out)", "rendered"]
    Image.fromarray(side_by_side(pictures, labels)).save(IMAGES / "edges.jpg", quality=90)


def scenes() -> None:
    """One view of each synthetic scene: RGB above, temperature in the scene's own range below."""
    columns = []
    for name in SCENES:
        with tempfile.TemporaryDirectory() as folder:
            write_capture(Path(folder) / name, SynthConfig(scene=name, frames=10, size=SIZE, thermal_clean=False))
            frame = load_capture(Path(folder) / name).frames[FRAME.get(name, 3)]
        lo, hi = np.percentile(frame.thermal, [0.5, 99.8])
        columns.append(np.concatenate([to_picture(frame.rgb), palette(frame.thermal, lo, hi)]))
    Image.fromarray(np.concatenate(columns, axis=1)).save(IMAGES / "scenes.jpg", quality=88)


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    if len(sys.argv) > 1:
        edges(Path(sys.argv[1]))
    else:
        scenes()
