"""`make faults`: 50 kills of runs at random moments, and full disks of 20 sizes at each place that is written to. Needs root for the disks.

    python -m tests.faults.campaign [--kills 50] [--sizes 20] [--seed 0]

Ends with two tables, and with exit code 1 where anything was wrong.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
from tests.faults import full_disks, kills
from tests.faults.processes import can_mount, results
from tests.helpers.tiny_run import SYNTH, TINY, recorded

from rtgs.synthetic import write_capture

SYNTH_COMMAND = ["synth", "--frames", "10", "--size", "48", "--supersampling", "1", "--seed", "3", "--no-thermal-clean", "--out"]


def disks(folder: Path, capture: Path, whole: Path, sizes: int) -> list[full_disks.Attempt]:
    """Runs, captures, exports and TMPDIR at so many sizes each."""
    attempts: list[full_disks.Attempt] = []
    disk = folder / "disk"
    out = disk / "out"

    def several(what: str, arguments: list[str], reference: Path, least: float, most: float) -> None:
        expected = results(reference)
        for size in np.geomspace(least, most, sizes).astype(int).tolist():
            attempts.append(full_disks.attempt(what, arguments, disk, out, size, expected))
            print(attempts[-1], flush=True)

    assert recorded([*SYNTH_COMMAND, str(folder / "synth")])[1] == 0
    assert recorded(["export", str(whole), "--out", str(folder / "export")])[1] == 0
    several("capture", [*SYNTH_COMMAND, str(out)], folder / "synth", 4e3, 300e3)
    several("export", ["export", str(whole), "--out", str(out)], folder / "export", 4e3, 300e3)
    # Features are few, so that room for COLMAP's database is not what decides.
    several("run", ["run", str(capture), "--out", str(out), *TINY, *FEW], whole, 8e3, 3e6)
    for size in np.geomspace(4096, 1e6, sizes).astype(int).tolist():
        target = folder / "without"
        shutil.rmtree(target, ignore_errors=True)
        export = ["export", str(whole), "--out", str(target)]
        attempts.append(full_disks.without_temporary_space(export, disk, target, size, results(folder / "export")))
    target = folder / "a run"
    run = ["run", str(capture), "--out", str(target), *TINY, *FEW]
    attempts.append(full_disks.without_temporary_space(run, disk, target, 4096, results(whole)))
    return attempts


FEW = ["--sfm.max-features", "30"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--sizes", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    killed: list[kills.Kill] = []
    attempts: list[full_disks.Attempt] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        capture = folder / "capture"
        write_capture(capture, SYNTH)
        if given.kills:
            killed = kills.campaign(
                lambda run: ["run", str(capture), "--out", str(run), *TINY], folder, given.kills, seed=given.seed
            )
        if given.sizes and can_mount():
            assert recorded(["run", str(capture), "--out", str(folder / "finished"), *TINY, *FEW])[1] == 0
            attempts = disks(folder, capture, folder / "finished", given.sizes)
        elif given.sizes:
            print("full disks are left out: this user may not mount file systems")
    print("\n".join([kills.table(killed), "", full_disks.table(attempts)]))
    return 1 if any(k.wrong for k in killed) or any(a.wrong for a in attempts) else 0


if __name__ == "__main__":
    sys.exit(main())
