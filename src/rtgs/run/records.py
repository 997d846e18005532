"""What a run keeps about its capture: `capture_summary.json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from rtgs.records.scene import Scene


@dataclass(frozen=True)
class CaptureSummary:
    """The facts about a capture that the report shows.

    Attributes:
        frames: image pairs in the folder. registered: those that have a pose.
        failures: frame → why it has none.
        warnings: what a person should know about the capture.
        thermal_unit: "relative" where `rig.json` gives no radiometry.
        rgb_size, thermal_size: width and height in pixels, as used.
        baseline_m: distance between the two cameras in metres; None where nothing states it.
    """

    frames: int
    registered: int
    failures: Mapping[str, str]
    warnings: Sequence[str]
    thermal_unit: Literal["celsius", "relative"]
    rgb_size: tuple[int, int]
    thermal_size: tuple[int, int]
    baseline_m: float | None = None

    @staticmethod
    def of(scene: Scene) -> CaptureSummary:
        """From the scene that the sfm stage made."""
        capture, rig = scene.capture, scene.rig
        return CaptureSummary(
            frames=len(capture.frames),
            registered=len(scene.frames),
            failures=dict(scene.failures),
            warnings=capture.warnings,
            thermal_unit="celsius" if capture.radiometry.unit == "°C" else "relative",
            rgb_size=(rig.rgb.width, rig.rgb.height),
            thermal_size=(rig.thermal.width, rig.thermal.height),
            baseline_m=rig.baseline_m,
        )
