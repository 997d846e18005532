"""Settings of structure from motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from rtgs.base.errors import RtgsError
from rtgs.config.ranges import Range, check_ranges


@dataclass(frozen=True)
class SfmConfig:
    """Structure from motion."""

    max_features: Annotated[int, Range(1, 10**6)] = 4096
    """SIFT points kept in an image, largest first."""
    max_image_side: Annotated[int, Range(16, 10**5)] = 1280
    """Features are found in images no longer than this, in pixels."""
    matching: Literal["auto", "exhaustive", "sequential"] = "auto"
    """"exhaustive" compares all pairs, "sequential" neighbours in name order (videos), "auto" takes exhaustive up to 80 frames."""
    seed: Annotated[int, Range(0, 2**31 - 1)] = 0
    """Of COLMAP's random choices. Two runs then differ by rounding alone, from sums in threads."""

    def __post_init__(self) -> None:
        if self.matching not in ("auto", "exhaustive", "sequential"):
            raise RtgsError(f"sfm.matching is {self.matching!r}; it is auto, exhaustive or sequential.")
        check_ranges(self, "sfm")
