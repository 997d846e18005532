"""Results in a few lines of text."""

from __future__ import annotations

from rtgs.evaluation.records import Evaluation
from rtgs.metrics.scores import SCORES

MODEL_TITLES = {"rgb": "RGB", "thermal": "thermal", "thermal_naive": "thermal at scale 1 (control)"}
"""The models of `Evaluation.models` for people."""


def metric_lines(evaluation: Evaluation) -> list[str]:
    """One line a model: RGB, thermal and the control at scale 1. A model without a score has no line."""
    lines = []
    for key, model in evaluation.models.items():
        shown = [f"{SCORES[name].title} {SCORES[name].text(value)}" for name, value in model.known().items()]
        if shown:
            lines.append(f"held-out {MODEL_TITLES[key]}: " + ", ".join(shown))
    return lines
