"""Settings of the list of hot and cold spots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from rtgs.config.ranges import Range, check_ranges


@dataclass(frozen=True)
class SpotsConfig:
    """What counts as a spot. Temperatures are in °C, or in counts for a capture in counts.

    A temperature or a percentile takes the place of the excess: whole areas beyond it are listed, warm objects too.
    """

    excess: Annotated[float, Range(above=0)] = 3.0
    """A spot is warmer or colder than the surface around it by this much."""
    above: Annotated[float | None, Range()] = None
    """Instead: what is warmer than this."""
    below: Annotated[float | None, Range()] = None
    """Instead: what is colder than this."""
    percentile: Annotated[float | None, Range(50, below=100)] = None
    """Instead: what is warmer than this percentile of the training images, and what is colder than 100 minus it."""
    reference: Annotated[float | None, Range()] = None
    """A temperature to which differences are given as well."""
    fewest_views: Annotated[int, Range(1)] = 3
    """Training views that show a spot at the same place of the surface."""
    most: Annotated[int, Range(1)] = 100
    """Most spots of the list; the strongest come first."""

    def __post_init__(self) -> None:
        check_ranges(self, "spots")
