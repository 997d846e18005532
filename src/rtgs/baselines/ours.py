"""This package's own answer, called as a user would: no start, no option but the solver."""

from __future__ import annotations

from rtgs.config import ScaleConfig
from rtgs.models import RgbModel
from rtgs.scale import ScaleEstimate, estimate_scale
from rtgs.scene import Scene

KEY = "ours"
TITLE = "ours"


def ours(scene: Scene, model: RgbModel) -> ScaleEstimate:
    """The global search."""
    return estimate_scale(scene, model, ScaleConfig(solver="global"))
