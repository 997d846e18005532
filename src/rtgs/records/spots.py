"""Hot and cold spots: the list that an inspector wants."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

from rtgs.records.metres import LengthUnit
from rtgs.records.radiometry import Unit


@dataclass(frozen=True)
class Spot:
    """One spot. Temperatures are in the list's unit, lengths in metres, or in the list's unit of length.

    Each value is the median over the training views that show the spot.

    Attributes:
        kind: "hot" or "cold".
        position_m: centre, in SfM's world, divided by its SfM units per metre.
        area_m2: of the surface where at least half of the excess is; of what is beyond the threshold, where there is one.
        extreme: highest (lowest) temperature in the photographs, not lowered by the mean over a pixel.
        mean: over the area. surroundings: of the surface around.
        std: standard error of `extreme`, from its scatter over the views and from what pixels blur; None for a single view.
        views: how many training photographs show it. seen_by: how many see the place.
        best_frames: up to three frames that show it largest.
        modelled: the model's highest (lowest) temperature there. modelled_std: its standard error, from the scatter over the views.
        latitude_deg, longitude_deg, altitude_m: of the centre, in WGS 84; None where the photographs do not tell it.
    """

    kind: Literal["hot", "cold"]
    position_m: tuple[float, float, float]
    area_m2: float
    extreme: float
    mean: float
    surroundings: float
    std: float | None
    views: int
    seen_by: int
    best_frames: tuple[str, ...]
    modelled: float
    modelled_std: float | None
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    altitude_m: float | None = None

    JSON_PROPERTIES: ClassVar = ("excess", "diameter_m", "model_differs")

    @property
    def excess(self) -> float:
        """`extreme` less `surroundings`."""
        return self.extreme - self.surroundings

    @property
    def diameter_m(self) -> float:
        """Of a disk of that area."""
        return 2 * math.sqrt(self.area_m2 / math.pi)

    @property
    def model_differs(self) -> bool:
        """Whether model and photographs differ by more than twice the standard error of their difference."""
        if self.std is None or self.modelled_std is None:
            return False
        return abs(self.modelled - self.extreme) > 2 * math.hypot(self.std, self.modelled_std)


@dataclass(frozen=True)
class ReferenceTemperature:
    """What spots are compared with.

    Attributes:
        name: of the user's; "" where none was given.
        temperature: as stated, or as the model shows the region: median over the views.
        std: standard error of a measured one: root mean square difference of model and photographs, over the views. None where stated.
        views: training photographs that see the whole region; 0 where stated.
    """

    name: str
    temperature: float
    std: float | None = None
    views: int = 0


@dataclass(frozen=True)
class SpotList:
    """The spots of a capture, the strongest first.

    Attributes:
        unit: of temperatures.
        criterion: what counts as a spot, in words.
        reference: to which differences are given; None where none was named.
        length_unit: of all lengths, also of those whose names end in `_m`.
    """

    spots: tuple[Spot, ...]
    unit: Unit
    criterion: str
    reference: ReferenceTemperature | None = None
    length_unit: LengthUnit = "m"

    def off_reference(self, spot: Spot) -> float | None:
        """`extreme` less the reference; None without one."""
        return None if self.reference is None else spot.extreme - self.reference.temperature
