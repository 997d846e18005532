"""A tiny synthetic capture and whole runs of it, for tests of what a run writes and how it is resumed."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plyfile import PlyData
from tests.helpers.recorder import Recorder

from rtgs.cli import main
from rtgs.config import SynthConfig
from rtgs.run.folder import RunFolder
from rtgs.run.pipeline import Pipeline
from rtgs.run.stages import STAGES

SYNTH = SynthConfig(scene="lego", frames=10, size=48, supersampling=1, seed=3, thermal_clean=False)
HELD_OUT = ("frame_000", "frame_008")
RGB_FLAGS = {"steps": 40, "random-points": 250, "densify.max-gaussians": 400, "densify.every": 10}
SCALE_FLAGS: dict[str, int | str] = {"solver": "adam", "steps": 5, "scan-samples": 25}
THERMAL_FLAGS = {"steps": 10}


def flags(settings: Mapping[str, int | str], prefix: str = "") -> list[str]:
    return [text for name, value in settings.items() for text in (f"--{prefix}{name}", str(value))]


TINY = [*flags(RGB_FLAGS, "rgb."), *flags(SCALE_FLAGS, "scale."), *flags(THERMAL_FLAGS, "thermal.")]


def recorded(arguments: list[str], stop_in: str | None = None, stop_at: int = 1) -> tuple[Recorder, int]:
    """Run the command line with a `Recorder` in the terminal's place; returns it and the exit code."""
    recorder = Recorder(stop_in, stop_at)
    try:
        main(arguments, recorder)
    except SystemExit as stop:
        return recorder, int(stop.code or 0)
    return recorder, 0


def strict_json(path: Path) -> Any:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{path}: holds {constant}, which is not JSON")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


def assert_close(a: Any, b: Any, where: str = "") -> None:
    """Nested numbers agree to 1e-4."""
    if isinstance(a, dict):
        assert a.keys() == b.keys(), where
        for key in a:
            assert_close(a[key], b[key], f"{where}.{key}")
    elif isinstance(a, list):
        assert len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            assert_close(x, y, f"{where}[{i}]")
    elif isinstance(a, float):
        assert b == pytest.approx(a, rel=1e-4, abs=1e-6), where
    else:
        assert a == b, where


def assert_same_results(a: Path, b: Path) -> None:
    """Scale, scores and every number of the models agree to 1e-4."""
    assert_close(strict_json(a / "scale.json"), strict_json(b / "scale.json"), "scale")
    metrics = [strict_json(run / "metrics.json") for run in (a, b)]
    assert metrics[0].pop("timings_s").keys() == metrics[1].pop("timings_s").keys()
    assert_close(metrics[0], metrics[1], "metrics")
    for name in ("rgb", "thermal", "thermal_naive"):
        one, other = (PlyData.read(str(run / f"{name}.ply"))["vertex"].data for run in (a, b))
        assert one.dtype == other.dtype and len(one) == len(other), name
        for field in one.dtype.names:
            np.testing.assert_allclose(one[field], other[field], rtol=1e-4, atol=1e-4, err_msg=f"{name} {field}")
        assert_close(strict_json(a / f"{name}.json"), strict_json(b / f"{name}.json"), name)
    files = [
        {str(p.relative_to(run)) for p in run.rglob("*")} - {"hashes.json"} for run in (a, b)
    ]  # written once files have settled
    assert files[0] == files[1]  # and nothing is left over


NOT_RESULTS = ("config.json", "hashes.json", "report.html")
"""Files that a call which finds everything done may write again."""


def state(folder: Path, *, but: tuple[str, ...] = ()) -> dict[str, tuple[int, bytes]]:
    return {
        str(p.relative_to(folder)): (p.stat().st_mtime_ns, p.read_bytes())
        for p in folder.rglob("*")
        if p.is_file() and p.name not in but
    }


def complete_stages(run: Path) -> list[str]:
    """Names of the stages that are complete under the run's own settings."""
    folder = RunFolder(run)
    now = Pipeline(folder).fingerprints()
    return [stage.name for stage in STAGES if folder.is_complete(stage, now[stage.name])]


def all_complete(run: Path) -> bool:
    return complete_stages(run) == [stage.name for stage in STAGES]
