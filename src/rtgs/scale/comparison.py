"""How the global search compares pictures."""

from __future__ import annotations

from dataclasses import dataclass

from rtgs.images.filters import SOBEL


@dataclass(frozen=True)
class Comparison:
    """Choices of the global search. The defaults are the method; anything else is for an ablation.

    Attributes:
        edge: ε in mean gradients: how far above the mean a gradient begins to count as an edge.
        per_edge, across: as in `EdgeLoss`.
        without_pattern: the sensor's pattern is taken out of the thermal images.
        covered: count only pixels that the model covers, as the thermal camera would see it from where the RGB camera is.
        match_blur: renders are blurred as far as the thermal images are found to be softer.
    """

    edge: float = 3.0
    per_edge: bool = True
    across: tuple[float, float] = SOBEL
    without_pattern: bool = True
    covered: bool = False
    match_blur: bool = True


COMPARISON = Comparison()
