"""This package's own answer, called as a user would: no start, no option but the solver."""

from __future__ import annotations

from dataclasses import dataclass, field

from rtgs.config import ScaleConfig
from rtgs.models import RgbModel
from rtgs.records.scene import Scene
from rtgs.scale import Comparison, ScaleEstimate, estimate_scale


@dataclass(frozen=True)
class OurMethod:
    """A way to call `estimate_scale`. key: in file names. title: in tables."""

    key: str
    title: str
    config: ScaleConfig
    comparison: Comparison = field(default_factory=Comparison)

    def __call__(self, scene: Scene, model: RgbModel) -> ScaleEstimate:
        return estimate_scale(scene, model, self.config, comparison=self.comparison)


OURS = OurMethod("ours", "ours", ScaleConfig(solver="global"))
OURS_REFINED = OurMethod(
    "ours_refined", "ours, refined", ScaleConfig(solver="global", refine=("rotation", "baseline-direction", "focal"))
)
