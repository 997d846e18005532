"""The defaults of the scale's search beside the paper's values and other choices, one at a time."""

from __future__ import annotations

from dataclasses import replace

from rtgs.config import PAPER_EPSILON
from rtgs.experiments.rivals import OURS, OurMethod
from rtgs.scale import Comparison


def _changed(key: str, title: str, comparison: Comparison | None = None, **settings: object) -> OurMethod:
    config = replace(OURS.config, **settings)  # type: ignore[arg-type]
    return OurMethod(f"{OURS.key}_{key}", title, config, comparison or OURS.comparison)


ABLATION = (
    _changed("epsilon_paper", "ε = 1e-6 as in the paper", epsilon=PAPER_EPSILON),
    _changed("paper_loss", "the paper's loss: ε = 1e-6, not per edge", Comparison(per_edge=False), epsilon=PAPER_EPSILON),
    _changed("epsilon_large", "ε = 0.1 for both images", epsilon=0.1),
    _changed("edge_1", "ε one mean gradient", Comparison(edge=1.0)),
    _changed("eq_6", "not per edge", Comparison(per_edge=False)),
    _changed("scharr", "Scharr's filters", Comparison(across=(0.75, 2.5))),
    _changed("central", "central differences", Comparison(across=(0.0, 4.0))),
    _changed("covered", "only pixels that the model covers", Comparison(covered=True)),
    _changed("with_pattern", "the sensor's pattern left in", Comparison(without_pattern=False)),
    _changed("single_scale", "full size alone", level_weights=(1.0,)),
    _changed("equal_weights", "levels weighted 1, 1, 1", level_weights=(1.0, 1.0, 1.0)),
    _changed("coarse_weights", "levels weighted 0.25, 0.5, 1", level_weights=(0.25, 0.5, 1.0)),
    _changed("frames_16", "16 frames", max_frames=16),
    _changed("frames_8", "8 frames", max_frames=8),
)
