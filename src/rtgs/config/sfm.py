"""Settings of structure from motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rtgs.base.errors import RtgsError


@dataclass(frozen=True)
class SfmConfig:
    """Structure from motion."""

    max_features: int = 4096
    """SIFT points kept in an image, largest first."""
    max_image_side: int = 1280
    """Features are found in images no longer than this, in pixels."""
    matching: Literal["auto", "exhaustive", "sequential"] = "auto"
    """"exhaustive" compares all pairs, "sequential" neighbours in name order (videos), "auto" takes exhaustive up to 80 frames."""
    seed: int = 0
    """Of COLMAP's random choices. Two runs then differ by rounding alone, from sums in threads."""

    def __post_init__(self) -> None:
        if self.matching not in ("auto", "exhaustive", "sequential"):
            raise RtgsError(f"sfm.matching is {self.matching!r}; it is auto, exhaustive or sequential.")
        for name in ("max_features", "max_image_side"):
            if getattr(self, name) < 1:
                raise RtgsError(f"sfm.{name} is {getattr(self, name)}; it is above 0.")
