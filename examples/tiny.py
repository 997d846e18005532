"""What the numbered examples work on: the folder named on the command line, or a tiny synthetic one that is made for the occasion."""

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rtgs
from rtgs.cli import main
from rtgs.synthetic import SynthConfig, write_capture

TINY = SynthConfig(frames=16, size=96, thermal_clean=False)
TINY_RGB = rtgs.RgbConfig(quality="fast", steps=500, random_points=1000)


@contextmanager
def capture_or_tiny() -> Iterator[tuple[Path, rtgs.RgbConfig]]:
    """A capture folder, and settings of the RGB model that suit it."""
    if len(sys.argv) > 1:
        yield Path(sys.argv[1]), rtgs.RgbConfig()
        return
    with tempfile.TemporaryDirectory() as folder:
        truth = write_capture(Path(folder) / "capture", TINY)
        yield Path(folder) / "capture", TINY_RGB
        print(f"(the truth of this synthetic capture: {truth.sfm_per_metre:.5g} SfM units per metre)")


@contextmanager
def run_or_tiny() -> Iterator[Path]:
    """A finished run folder."""
    if len(sys.argv) > 1:
        yield Path(sys.argv[1])
        return
    with capture_or_tiny() as (capture, rgb):
        run = capture.parent / "run"
        options = f"--rgb.quality {rgb.quality} --rgb.steps {rgb.steps} --rgb.random-points {rgb.random_points}"
        main(["run", str(capture), "--out", str(run), *options.split()])
        yield run
