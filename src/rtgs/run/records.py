"""What a run keeps about its capture: `capture_summary.json`, and `scene/world.json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import from_json, read_json
from rtgs.maths.geometry import Sim3
from rtgs.records.radiometry import Unit
from rtgs.records.rgb_camera import FoundRgbCamera
from rtgs.records.scene import Scene

_EARLIER_UNITS = {"celsius": "°C", "relative": "counts"}


@dataclass(frozen=True)
class CaptureSummary:
    """The facts about a capture that the report shows.

    Attributes:
        frames: image pairs in the folder. registered: those that have a pose.
        failures: frame → why it has none.
        warnings: what a person should know about the capture.
        unit: of thermal images; "counts" where `rig.json` gives no radiometry.
        rgb_size, thermal_size: width and height in pixels, as used.
        baseline_m: distance between the two cameras in metres; None where nothing states it.
        rgb_camera: what structure from motion found of the RGB camera; None where `rig.json` or the poses give all of it.
    """

    frames: int
    registered: int
    failures: Mapping[str, str]
    warnings: Sequence[str]
    unit: Unit
    rgb_size: tuple[int, int]
    thermal_size: tuple[int, int]
    baseline_m: float | None = None
    rgb_camera: FoundRgbCamera | None = None

    @staticmethod
    def of(scene: Scene) -> CaptureSummary:
        """From the scene that the sfm stage made."""
        capture, rig = scene.capture, scene.rig
        return CaptureSummary(
            frames=len(capture.frames),
            registered=len(scene.frames),
            failures=dict(scene.failures),
            warnings=capture.warnings,
            unit=capture.radiometry.unit,
            rgb_size=(rig.rgb.width, rig.rgb.height),
            thermal_size=(rig.thermal.width, rig.thermal.height),
            baseline_m=rig.baseline_m if rig.start is None else rig.start.baseline_m,
            rgb_camera=capture.found_rgb,
        )

    @staticmethod
    def read(path: Path) -> CaptureSummary:
        """From `capture_summary.json`; `thermal_unit`, as 0.1.0 called the unit, is understood too.

        Raises:
            RtgsError: the file is missing or damaged, or of another version.
        """
        data = read_json(path)
        if isinstance(data, dict) and "thermal_unit" in data:
            earlier = data.pop("thermal_unit")
            data["unit"] = _EARLIER_UNITS.get(earlier, earlier)
        try:
            return from_json(CaptureSummary, data, str(path))
        except RtgsError as error:
            raise RtgsError(f"{error} Remove it and run again.") from None


@dataclass(frozen=True)
class WorldFile:
    """`scene/world.json`: which world was computed in, x_given = factor · x_world + translation.

    Attributes:
        factor: SfM units per unit of the world. translation: `[3]`, SfM units.
    """

    factor: float
    translation: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not 1e-30 < self.factor < 1e30:
            raise RtgsError(f"factor is {self.factor:g}; it is a length, above 0.")

    @staticmethod
    def of(given_from_world: Sim3) -> WorldFile:
        x, y, z = given_from_world.translation.tolist()
        return WorldFile(given_from_world.factor, (x, y, z))

    @property
    def given_from_world(self) -> Sim3:
        """The similarity; it does not turn."""
        return Sim3(self.factor, np.eye(3), np.array(self.translation))
