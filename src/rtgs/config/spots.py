"""Settings of the list of hot and cold spots."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from rtgs.base.errors import RtgsError
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
    reference: str | None = None
    """Differences to it are given as well. A temperature (21), or a region whose temperature is measured: a rectangle of thermal pixels of
    a frame (FRAME:LEFT,TOP,RIGHT,BOTTOM), or a place with a radius, in metres as in the list (X,Y,Z,RADIUS). NAME= before it names it."""
    fewest_views: Annotated[int, Range(1)] = 3
    """Training views that show a spot at the same place of the surface."""
    most: Annotated[int, Range(1)] = 100
    """Most spots of the list; the strongest come first."""

    def __post_init__(self) -> None:
        check_ranges(self, "spots")
        if self.reference is not None:
            parse_reference(self.reference)


@dataclass(frozen=True)
class Reference:
    """What differences refer to. One of `temperature`, `frame` with `box`, and `place` with `radius` is given.

    Attributes:
        name: "" where it has none. box: left, top, right, bottom in thermal pixels; right and bottom are not part of it.
        place, radius: in the list's unit of length.
    """

    name: str
    temperature: float | None = None
    frame: str | None = None
    box: tuple[int, int, int, int] | None = None
    place: tuple[float, float, float] | None = None
    radius: float | None = None


def parse_reference(text: str) -> Reference:
    """Read "[NAME=]21", "[NAME=]FRAME:LEFT,TOP,RIGHT,BOTTOM" or "[NAME=]X,Y,Z,RADIUS".

    Raises:
        RtgsError: it is none of these.
    """
    name, _, what = text.rpartition("=")
    frame, _, numbers = what.rpartition(":")
    try:
        values = [float(v) for v in numbers.split(",")]
    except ValueError:
        values = []
    fine = all(math.isfinite(v) for v in values)
    if fine and frame and len(values) == 4 and all(v == int(v) for v in values):
        left, top, right, bottom = (int(v) for v in values)
        if 0 <= left < right and 0 <= top < bottom:
            return Reference(name, frame=frame, box=(left, top, right, bottom))
    elif fine and not frame and len(values) == 1:
        return Reference(name, temperature=values[0])
    elif fine and not frame and len(values) == 4 and values[3] > 0:
        return Reference(name, place=(values[0], values[1], values[2]), radius=values[3])
    raise RtgsError(
        f"spots.reference is {text!s:.80}; it is a temperature (21), a rectangle of thermal pixels (FRAME:LEFT,TOP,RIGHT,BOTTOM), or a "
        "place with a radius (X,Y,Z,RADIUS). NAME= may stand before it."
    )
