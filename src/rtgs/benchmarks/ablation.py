"""The defaults of the scale's search beside the paper's values and other choices, one at a time."""

from __future__ import annotations

from dataclasses import replace

from rtgs.baselines import OURS, Own
from rtgs.config import PAPER_EPSILON


def _changed(key: str, title: str, **settings: object) -> Own:
    return Own(f"{OURS.key}_{key}", title, replace(OURS.config, **settings))  # type: ignore[arg-type]


ABLATION = (
    _changed("epsilon_paper", "ε = 1e-6 as in the paper", epsilon=PAPER_EPSILON),
    _changed("epsilon_large", "ε = 0.1 for both images", epsilon=0.1),
    _changed("single_scale", "full size alone", level_weights=(1.0,)),
    _changed("equal_weights", "levels weighted 1, 1, 1", level_weights=(1.0, 1.0, 1.0)),
    _changed("coarse_weights", "levels weighted 0.25, 0.5, 1", level_weights=(0.25, 0.5, 1.0)),
    _changed("frames_16", "16 frames", max_frames=16),
    _changed("frames_8", "8 frames", max_frames=8),
)
