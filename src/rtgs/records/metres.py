"""What the metres of a run rest on: sources, each with its own estimate of the scale, and what they say together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal, TypeAlias

from rtgs.base.errors import RtgsError

NORMAL_95 = 1.959963984540054

LengthUnit: TypeAlias = Literal["m", "SfM units"]
"""Of lengths: SfM units where nothing tells metres."""


@dataclass(frozen=True)
class MetresSource:
    """One estimate of how many SfM units a metre is.

    Attributes:
        name: "baseline", "gps", "distance 1", "board", "laser", …
        sfm_per_metre: SfM units per metre.
        std_log: standard deviation of ln `sfm_per_metre`.
        explanation: one sentence for a person: from what, and how good that is.
    """

    JSON_PROPERTIES: ClassVar[tuple[str, ...]] = ("ci95",)

    name: str
    sfm_per_metre: float
    std_log: float
    explanation: str

    def __post_init__(self) -> None:
        if not (0 < self.sfm_per_metre < math.inf and 0 < self.std_log < math.inf):
            raise RtgsError(
                f"{self.name}: sfm_per_metre is {self.sfm_per_metre:g} and std_log {self.std_log:g}; both are finite and above 0."
            )

    @property
    def ci95(self) -> tuple[float, float]:
        """95 % interval of `sfm_per_metre`."""
        return interval95(self.sfm_per_metre, self.std_log)


@dataclass(frozen=True)
class Metres:
    """What the sources say together.

    Attributes:
        sfm_per_metre: of the sources that it rests on, weighted by their inverse variances; None where there is no source.
        std_log: standard deviation of its logarithm; wider where sources disagree. None likewise.
        sources: all that give an estimate. rests_on: the names of those that count.
        absent: source → why it gives no estimate.
        chance: of sources as far apart as these if all were right (χ² test); None with fewer than two.
        disagreement: which sources disagree, in words; empty where they agree.
    """

    JSON_PROPERTIES: ClassVar[tuple[str, ...]] = ("ci95",)

    sfm_per_metre: float | None
    std_log: float | None
    sources: tuple[MetresSource, ...] = ()
    rests_on: tuple[str, ...] = ()
    absent: Mapping[str, str] = field(default_factory=dict)
    chance: float | None = None
    disagreement: str = ""

    def __post_init__(self) -> None:
        if self.sfm_per_metre is not None and not 0 < self.sfm_per_metre < math.inf:
            raise RtgsError(f"sfm_per_metre is {self.sfm_per_metre:g}; it is a finite number above 0.")

    @property
    def ci95(self) -> tuple[float, float] | None:
        """95 % interval of `sfm_per_metre`; None without a source."""
        if self.sfm_per_metre is None or self.std_log is None:
            return None
        return interval95(self.sfm_per_metre, self.std_log)


def interval95(sfm_per_metre: float, std_log: float) -> tuple[float, float]:
    """The 95 % interval of a scale whose logarithm is normal."""
    factor = math.exp(min(NORMAL_95 * std_log, 700.0))
    return sfm_per_metre / factor, sfm_per_metre * factor
