"""Results in a few lines of text."""

from __future__ import annotations

from rtgs.evaluation.records import Evaluation
from rtgs.metrics.scores import SCORES
from rtgs.records.metres import Metres, MetresSource

MODEL_TITLES = {"rgb": "RGB", "thermal": "thermal", "thermal_naive": "thermal at scale 1 (control)"}
"""The models of `Evaluation.models` for people."""


def metres_lines(metres: Metres) -> list[str]:
    """What lengths rest on: a line for each source, and one for each that was looked for in vain.

    Empty where the baseline is the only source and nobody would expect another.
    """
    lines = [
        f"metres: {s.name} {s.sfm_per_metre:.5g} ± {100 * s.std_log:.2g} %{_left_out(s, metres)}: {s.explanation}"
        for s in metres.sources
    ]
    if len(metres.sources) > 1 and metres.sfm_per_metre is not None and metres.std_log is not None:
        rest = " and ".join(metres.rests_on)
        lines.append(f"metres: {metres.sfm_per_metre:.5g} SfM units per metre ± {100 * metres.std_log:.2g} %, from {rest}")
    lines += [f"metres: nothing from {name}: {reason}" for name, reason in metres.absent.items() if name != "baseline"]
    return lines if [s.name for s in metres.sources] != ["baseline"] or len(lines) > 1 else []


def _left_out(source: MetresSource, metres: Metres) -> str:
    return "" if source.name in metres.rests_on else " (does not count)"


def metric_lines(evaluation: Evaluation) -> list[str]:
    """One line a model: RGB, thermal and the control at scale 1. A model without a score has no line."""
    lines = []
    for key, model in evaluation.models.items():
        shown = [f"{SCORES[name].title} {SCORES[name].text(value)}" for name, value in model.known().items()]
        if shown:
            lines.append(f"held-out {MODEL_TITLES[key]}: " + ", ".join(shown))
    return lines
