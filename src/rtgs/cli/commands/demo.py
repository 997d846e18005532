"""`rtgs demo`: the whole method on a small synthetic capture."""

from __future__ import annotations

from pathlib import Path

from rtgs.base.events import Listener, ResultLine
from rtgs.base.json_records import to_json
from rtgs.cli.commands.convert import make_synthetic
from rtgs.cli.commands.run import run as whole_run
from rtgs.cli.options import Hidden
from rtgs.config import RgbConfig, RunConfig, SynthConfig

CAPTURE = SynthConfig(scene="lego", frames=32, size=200, seed=3)
RUN = RunConfig(rgb=RgbConfig(steps=1500))


def demo(listener: Hidden, out: Path = Path("rtgs-demo")) -> None:
    """See the whole method work: a small synthetic capture, a run, and the truth beside the result.

    Args:
        out: folder for the capture and the run.
    """
    demonstrate(out, CAPTURE, RUN, listener)


def demonstrate(out: Path, capture: SynthConfig, config: RunConfig, listener: Listener) -> None:
    """Make the capture if it is not there, run it, and say how far the scale is from the truth."""
    from rtgs.io.rig import finite_number, read_json_object
    from rtgs.run.folder import RunFolder

    rig_json, truth_json = out / "capture" / "rig.json", out / "capture" / "ground_truth.json"
    again = f"Remove {out / 'capture'} and call again."
    made = rig_json.exists() and truth_json.exists()
    if not made or read_json_object(truth_json, missing=again, remedy=again).get("config") != to_json(capture):
        make_synthetic(out / "capture", capture, listener)
    whole_run(out / "capture", out / "run", config, listener)
    truth = finite_number(truth_json, "sfm_per_metre", read_json_object(truth_json, missing=again), "sfm_per_metre")
    found = RunFolder(out / "run").read_scale().sfm_per_metre
    error = 100 * abs(found / truth - 1)
    listener(ResultLine(f"true scale {truth:.5g}, found {found:.5g} SfM units per metre: off by {error:.3f} %"))
