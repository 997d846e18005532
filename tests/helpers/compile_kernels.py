"""Fill Numba's cache with one tiny run, before test processes share it.

Two processes that compile the same kernel at once may get machine code that differs in the last bit, and tests that compare a run
across processes would see it.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from pathlib import Path

from rtgs.cli import main
from rtgs.synthetic import SynthConfig, write_capture

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        capture, run = Path(folder) / "capture", Path(folder) / "run"
        write_capture(capture, SynthConfig(frames=10, size=48, supersampling=1, thermal_clean=False))
        tiny = (
            "--rgb.steps 20 --rgb.random-points 250 --scale.solver adam --scale.steps 2 --scale.scan-samples 25 --thermal.steps 4"
        )
        main(["run", str(capture), "--out", str(run), *tiny.split()])
