"""Do two checkouts give bit-identical results? For changes that only move code.

    python benchmarks/same_results.py OLD NEW [--out DIR]

Each checkout runs, from its own `src/`, the demo and a small synthetic capture of a room whose sensor drifts and whose rig is
refined. `scale.json`, every PLY and `metrics.json` (without its timings) are compared byte by byte, or value by value for JSON.
Results stay in DIR (a folder per checkout), so that a second call against the same OLD only runs NEW: delete a folder to repeat it.

Exit code 0: identical; 1: something differs (every difference is printed).
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

SYNTH = "--scene room --frames 24 --size 120 --supersampling 1 --gain-jitter 0.04 --rig-rotation-error-deg 0.05 --seed 1"
RUN = "--rgb.steps 600 --rgb.sh-degree 1 --scale.refine focal rotation --thermal.drift gain-offset"


def run(checkout: Path, out: Path) -> None:
    """The two runs of one checkout, into `out`; what is finished is kept."""
    done = out / "done"
    if done.exists():
        return
    out.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, "PYTHONPATH": str(checkout / "src"), "NUMBA_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}

    def rtgs(*arguments: str) -> None:
        print(f"{checkout}: rtgs {' '.join(arguments)}", flush=True)
        subprocess.run([sys.executable, "-m", "rtgs", *arguments], check=True, env=environment, stdout=subprocess.DEVNULL)

    # The first call compiles: a kernel may differ in its last bit from the same kernel loaded from Numba's cache.
    rtgs("demo", "--out", str(out / "compiling"))
    shutil.rmtree(out / "compiling")
    rtgs("demo", "--out", str(out / "demo"))
    rtgs("synth", "--out", str(out / "room" / "capture"), *SYNTH.split())
    rtgs("run", str(out / "room" / "capture"), "--out", str(out / "room" / "run"), *RUN.split())
    done.touch()


def differences(a: Any, b: Any, where: str) -> list[str]:
    """Paths of JSON values that differ, keys that one side lacks included."""
    if isinstance(a, dict) and isinstance(b, dict):
        keys = sorted({*a, *b} - {"timings_s"})
        return [d for k in keys for d in differences(a.get(k, "absent"), b.get(k, "absent"), f"{where}.{k}")]
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        return [d for i, (x, y) in enumerate(zip(a, b, strict=True)) for d in differences(x, y, f"{where}[{i}]")]
    return [] if a == b else [f"{where}: {a!r:.60} and {b!r:.60}"]


def compare(old: Path, new: Path) -> list[str]:
    """What differs between the runs of two result folders."""
    found = []
    for name in ("demo", "room"):
        for file in ("scale.json", "metrics.json", "rgb.ply", "thermal.ply", "thermal_naive.ply"):
            a, b = old / name / "run" / file, new / name / "run" / file
            if file.endswith(".json"):
                before, after = (json.loads(p.read_text(encoding="utf-8")) for p in (a, b))
                some = differences(before, after, f"{name}/{file}")
            else:
                some = [] if a.read_bytes() == b.read_bytes() else [f"{name}/{file}: bytes differ"]
            print(f"{name}/{file}: {'identical' if not some else f'{len(some)} differences'}")
            found += some
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "rtgs-same-results")
    options = parser.parse_args()
    folders = []
    for checkout, which in ((options.old, "old"), (options.new, "new")):
        folders.append(options.out / which)
        run(checkout.resolve(), folders[-1])
    found = compare(*folders)
    print("\n".join(found[:50]))
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
