"""Rows of the tables: each changes the images, the calibration, or the number of frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from rtgs.config import SceneName, SynthConfig, SyntheticTable

REFERENCE = "reference"


@dataclass(frozen=True)
class Variant:
    """One row of Table II and of what goes beyond it.

    Attributes:
        key: in file names. title, level: in tables.
        changes: fields of `SynthConfig`.
        inverted: hot and cold change places in the thermal images.
        frames: how many training frames, evenly spaced; None: all.
        thermal_share: size of the thermal images as a share of the RGB images'.
    """

    key: str
    title: str
    level: str = "–"
    changes: dict[str, Any] = field(default_factory=dict)
    inverted: bool = False
    frames: int | None = None
    thermal_share: float = 1.0

    def applied_to(self, config: SynthConfig) -> SynthConfig:
        """The capture's settings with the changes of this row."""
        size = None if self.thermal_share == 1.0 else round(config.size * self.thermal_share)
        return replace(config, thermal_size=size, **self.changes)

    @property
    def cameras(self) -> tuple[Any, ...]:
        """Rows with equal values need the same renders."""
        moved = ("rig_direction_error", "rig_rotation_error_deg", "thermal_focal_error")
        return (self.thermal_share, *(self.changes.get(name, 0.0) for name in moved))

    @property
    def length_factor(self) -> float:
        """Baseline length as calibrated, divided by the true one. Eq. 1 has only the product s·|t|, so that this factor moves a loss curve
        along θ and changes nothing else."""
        return 1.0 + float(self.changes.get("rig_length_error", 0.0))


REFERENCE_ROW = Variant(REFERENCE, "reference")

PERTURBATIONS = (
    REFERENCE_ROW,
    Variant("blur_2", "thermal blur σ", "2 px", {"blur_px": 2.0}),
    Variant("blur_4", "thermal blur σ", "4 px", {"blur_px": 4.0}),
    Variant("agc", "AGC jitter", "mild", {"gain_jitter": 0.1}),
    Variant("length_1", "rig baseline length", "1 %", {"rig_length_error": 0.01}),
    Variant("length_2", "rig baseline length", "2 %", {"rig_length_error": 0.02}),
    Variant("focal_1", "thermal focal length", "1 %", {"thermal_focal_error": 0.01}),
    Variant("focal_2", "thermal focal length", "2 %", {"thermal_focal_error": 0.02}),
    Variant("direction_2", "rig baseline direction", "2 %", {"rig_direction_error": 0.02}),
)

FAR_SCENE: SceneName = "plain"
FAR = Variant("far", "a plain 800 m away instead")

BEYOND = (
    REFERENCE_ROW,
    Variant("frames_20", "training frames", "20", frames=20),
    Variant("frames_10", "training frames", "10", frames=10),
    Variant("frames_5", "training frames", "5", frames=5),
    Variant("netd_100", "thermal noise (NETD)", "100 mK", {"netd_c": 0.1}),
    Variant("inverted", "thermal contrast inverted", inverted=True),
    Variant("quarter", "thermal resolution", "a quarter", thermal_share=0.25),
)
"""Of the object scenes; `FAR` is the last row of the table."""


ROWS: dict[SyntheticTable, tuple[Variant, ...]] = {
    "1": (REFERENCE_ROW,),
    "2": PERTURBATIONS,
    "beyond": BEYOND,
    "ablation": (REFERENCE_ROW,),
}


def groups(variants: Sequence[Variant]) -> list[list[Variant]]:
    """The rows, grouped by the renders that they need."""
    found: dict[tuple[Any, ...], list[Variant]] = {}
    for variant in variants:
        found.setdefault(variant.cameras, []).append(variant)
    return list(found.values())
