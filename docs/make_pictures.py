"""Make the pictures of the documents: `python docs/make_pictures.py` writes `docs/images/scenes.jpg`."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from rtgs.io.capture import load_capture
from rtgs.pictures import palette, to_picture
from rtgs.synthetic import SCENES, SynthConfig, write_capture

SIZE = 224
FRAME = {"room": 4}


def main() -> None:
    """One view of each synthetic scene: RGB above, temperature in the scene's own range below."""
    columns = []
    for name in SCENES:
        with tempfile.TemporaryDirectory() as folder:
            write_capture(Path(folder) / name, SynthConfig(scene=name, frames=10, size=SIZE, thermal_clean=False))
            frame = load_capture(Path(folder) / name).frames[FRAME.get(name, 3)]
        lo, hi = np.percentile(frame.thermal, [0.5, 99.8])
        columns.append(np.concatenate([to_picture(frame.rgb), palette(frame.thermal, lo, hi)]))
    out = Path(__file__).parent / "images" / "scenes.jpg"
    out.parent.mkdir(exist_ok=True)
    Image.fromarray(np.concatenate(columns, axis=1)).save(out, quality=88)


if __name__ == "__main__":
    main()
