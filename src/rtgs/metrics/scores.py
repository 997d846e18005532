"""The scores by name: what they are called, their unit, and how many decimals of them mean something."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Score:
    """A kind of score.

    Attributes:
        title: as people call it.
        unit: "" where it has none.
        decimals: as shown.
    """

    title: str
    unit: str
    decimals: int

    @property
    def heading(self) -> str:
        """Of a column: title and unit."""
        return f"{self.title}, {self.unit}" if self.unit else self.title

    def number(self, value: float) -> str:
        """The value without its unit, for a cell of a table."""
        return f"{value:.{self.decimals}f}"

    def text(self, value: float) -> str:
        """The value with its unit."""
        return f"{self.number(value)} {self.unit}".rstrip()


SCORES: Mapping[str, Score] = {
    "psnr": Score("PSNR", "dB", 2),
    "ssim": Score("SSIM", "", 4),
    "lpips": Score("LPIPS (AlexNet)", "", 3),
    "lpips_vgg": Score("LPIPS (VGG)", "", 3),
    "mae_c": Score("MAE", "°C", 3),
    "mae_counts": Score("MAE", "counts", 1),
    "peak_c": Score("peak error", "°C", 2),
    "peak_p90_c": Score("peak error, 90 %", "°C", 2),
    "peak_counts": Score("peak error", "counts", 1),
    "peak_p90_counts": Score("peak error, 90 %", "counts", 1),
}
"""Name → score, in the order of columns. The names are those of `metrics.json` and of the tables' CSV files."""
