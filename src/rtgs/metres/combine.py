"""Sources of metres together: weighted by their variances where they agree, and an account of it where they do not."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from scipy.special import chdtrc

from rtgs.records.metres import NORMAL_95, Metres, MetresSource

UNLIKELY = 0.01
"""Chance (χ² test) below which sources are said to disagree."""


def combine(sources: Sequence[MetresSource], absent: Mapping[str, str] | None = None) -> Metres:
    """What the sources say together.

    Where they agree, all count. Otherwise the one that lies farthest from the others is left out until the rest agree; of two, the less
    certain one is. The 95 % interval is then so wide that it reaches all of them.
    """
    absent = dict(absent or {})
    if not sources:
        return Metres(None, None, absent=absent)
    chance, kept = _chance(sources), list(sources)
    while len(kept) > 1 and _chance(kept) < UNLIKELY:
        kept.remove(_farthest(kept))
    mean, std = _weighted(kept)
    disagreement = ""
    if len(kept) < len(sources):
        std = max(std, max(abs(math.log(s.sfm_per_metre) - mean) for s in sources) / NORMAL_95)
        disagreement = _said(sources, kept, chance)
    return Metres(
        sfm_per_metre=kept[0].sfm_per_metre if len(kept) == 1 else math.exp(mean),
        std_log=std,
        sources=tuple(sources),
        rests_on=tuple(s.name for s in kept),
        absent=absent,
        chance=chance if len(sources) > 1 else None,
        disagreement=disagreement,
    )


def _weighted(sources: Sequence[MetresSource]) -> tuple[float, float]:
    """Mean of ln s and its standard deviation, by inverse variances."""
    weights = [1 / s.std_log**2 for s in sources]
    mean = sum(w * math.log(s.sfm_per_metre) for w, s in zip(weights, sources, strict=True)) / sum(weights)
    return mean, 1 / math.sqrt(sum(weights))


def _chance(sources: Sequence[MetresSource]) -> float:
    if len(sources) < 2:
        return 1.0
    mean, _ = _weighted(sources)
    apart = sum(((math.log(s.sfm_per_metre) - mean) / s.std_log) ** 2 for s in sources)
    return float(chdtrc(len(sources) - 1, apart))


def _farthest(sources: Sequence[MetresSource]) -> MetresSource:
    if len(sources) == 2:
        return max(sources, key=lambda s: s.std_log)

    def distance(source: MetresSource) -> float:
        mean, std = _weighted([s for s in sources if s is not source])
        return abs(math.log(source.sfm_per_metre) - mean) / math.hypot(std, source.std_log)

    return max(sources, key=distance)


def _said(sources: Sequence[MetresSource], kept: Sequence[MetresSource], chance: float) -> str:
    each = "; ".join(f"{s.name} {s.sfm_per_metre:.5g} (95 %: {s.ci95[0]:.5g} to {s.ci95[1]:.5g})" for s in sources)
    names = " and ".join(s.name for s in kept)
    why = "it has the smallest standard deviation" if len(kept) == 1 else "they agree with each other"
    return (
        f"the sources of metres disagree. SfM units per metre are {each}; were all of them right, they would lie so far apart with a "
        f"chance of {max(chance, 1e-9):.1g} or less. Lengths rest on {names}, since {why}. Find out which source is wrong, and correct "
        "it or leave it out (--metres.sources)."
    )
