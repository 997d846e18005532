"""Write a capture from arrays of your own cameras: python examples/06_your_own_camera.py [OUT]. Replace `record` by your reader."""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

import rtgs


def record(instant: int) -> tuple[np.ndarray, np.ndarray]:
    """RGB `[H, W, 3]` uint8 and temperature `[h, w]` in °C of one instant. Here they are made up."""
    rows, columns = np.mgrid[0:60, 0:80]
    temperature_c = 20.0 + 10.0 * np.exp(-((columns - 20 - 4 * instant) ** 2 + (rows - 30) ** 2) / 200.0)
    return np.repeat((temperature_c[..., None] * 5).astype(np.uint8), 3, axis=2), temperature_c


def main(out: Path) -> None:
    (out / "rgb").mkdir(parents=True)
    (out / "thermal").mkdir()
    for instant in range(5):
        rgb, temperature_c = record(instant)
        Image.fromarray(rgb).save(out / "rgb" / f"{instant:04}.png")
        Image.fromarray(temperature_c.astype(np.float32)).save(out / "thermal" / f"{instant:04}.tiff")
    camera = {"model": "PINHOLE", "width": 80, "height": 60, "fl_x": 75.0, "fl_y": 75.0, "cx": 40.0, "cy": 30.0}
    thermal = camera | {"celsius_per_count": 1.0, "celsius_offset": 0.0}  # the TIFFs are in °C
    to_the_right = [[1, 0, 0, 0.05], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]  # the thermal camera, by 5 cm
    rig = {"rgb": camera, "thermal": thermal, "rgb_from_thermal": to_the_right}
    (out / "rig.json").write_text(json.dumps(rig, indent=1))
    capture = rtgs.load_capture(out)  # checks everything, by file and field
    print(f"{len(capture.frames)} pairs, baseline {capture.rig.baseline_m} m, up to {capture.frames[0].thermal.max():.1f} °C")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(temporary) / "capture")
