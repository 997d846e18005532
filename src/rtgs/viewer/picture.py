"""What is seen, as a picture: palettes, ranges, isotherms and layouts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from rtgs.images.pictures import BACKGROUND, NO_DATA, Picture, palette, to_picture
from rtgs.records.radiometry import ZERO_CELSIUS_K
from rtgs.viewer.engine import Floats, Seen

Show = Literal["RGB", "Temperature", "Blend", "Side by side"]
SHOWS: tuple[Show, ...] = get_args(Show)
Shade = Literal["°C", "°F", "K", "counts"]
PALETTES = {
    "Inferno": "inferno",
    "Hot metal": "gnuplot2",
    "Rainbow": "turbo",
    "Viridis": "viridis",
    "Gray": "gray",
    "Gray, inverted": "gray_r",
    "Blue to red": "coolwarm",
}
"""Name for people → matplotlib's."""
ISOTHERM = (64, 224, 128)
GAP_PX = 2


@dataclass(frozen=True)
class Look:
    """How what is seen is drawn. Temperatures are in the thermal model's unit.

    Attributes:
        show: which modality, or both.
        palette: a value of `PALETTES`.
        lo, hi: ends of the palette.
        isotherm: temperatures between these two are green; None: none are.
        blend: share of the temperature in "Blend".
    """

    show: Show = "RGB"
    palette: str = "inferno"
    lo: float = 0.0
    hi: float = 1.0
    isotherm: tuple[float, float] | None = None
    blend: float = 0.5

    @property
    def wants_rgb(self) -> bool:
        return self.show != "Temperature"

    @property
    def wants_temperature(self) -> bool:
        return self.show != "RGB"


def thermal_picture(temperature: Floats, look: Look) -> Picture:
    """`[H, W, 3]`: temperatures in the look's palette, with the isotherm."""
    picture = palette(temperature, look.lo, look.hi, look.palette)
    if look.isotherm is not None:
        lo, hi = look.isotherm
        picture[(temperature >= lo) & (temperature <= hi)] = ISOTHERM
    return picture


def picture_of(seen: Seen, look: Look) -> Picture:
    """`[H, W, 3]` for "RGB", "Temperature" and "Blend"; what has no model is a neutral gray."""
    size = (seen.eye.camera.height, seen.eye.camera.width)
    rgb = _plain(size) if seen.rgb is None else to_picture(seen.rgb)
    if look.show == "RGB":
        return rgb
    thermal = _plain(size) if seen.temperature is None else thermal_picture(seen.temperature, look)
    if look.show == "Temperature":
        return thermal
    return np.asarray(cv2.addWeighted(rgb, 1.0 - look.blend, thermal, look.blend, 0.0), np.uint8)


def beside(left: Picture, right: Picture) -> Picture:
    """Two pictures of one size, side by side with a gap: `[H, 2 W + GAP_PX, 3]`."""
    gap = np.full((left.shape[0], GAP_PX, 3), BACKGROUND, np.uint8)
    return np.concatenate([left, gap, right], axis=1)


def swept(left: Picture, right: Picture, share: float) -> Picture:
    """`left` up to this share of the width, `right` from there on, with a line between them; both of one size."""
    at = int(round(np.clip(share, 0.0, 1.0) * left.shape[1]))
    out = right.copy()
    out[:, :at] = left[:, :at]
    out[:, max(at - 2, 0) : at + 2] = 255
    return out


@dataclass(frozen=True)
class Frame:
    """Where a picture of `width` × `height` pixels lies on a screen: as large as fits, in the middle.

    Attributes:
        left, top: of the picture on the screen. factor: screen pixels per pixel of the picture.
    """

    left: float
    top: float
    factor: float

    @staticmethod
    def of(width: int, height: int, screen_width: int, screen_height: int) -> Frame:
        factor = min(screen_width / width, screen_height / height)
        return Frame(0.5 * (screen_width - factor * width), 0.5 * (screen_height - factor * height), factor)

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Pixels of the picture at pixels of the screen."""
        return (x - self.left) / self.factor, (y - self.top) / self.factor


def on_screen(picture: Picture, width: int, height: int) -> Picture:
    """`[height, width, 3]`: the picture as large as fits, in the middle of a screen."""
    rows, columns = picture.shape[:2]
    frame = Frame.of(columns, rows, width, height)
    out = np.full((height, width, 3), BACKGROUND, np.uint8)
    size = max(1, min(width, round(columns * frame.factor))), max(1, min(height, round(rows * frame.factor)))
    inside = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if frame.factor < 1 else cv2.INTER_LINEAR)
    top, left = round(frame.top), round(frame.left)
    top, left = min(top, height - size[1]), min(left, width - size[0])
    out[top : top + size[1], left : left + size[0]] = inside
    return out


def percentiles(temperature: Floats, low: float, high: float) -> tuple[float, float] | None:
    """The range between two percentiles of what is seen; None where nothing is."""
    values = temperature[np.isfinite(temperature)]
    if not values.size:
        return None
    lo, hi = (float(v) for v in np.percentile(values, [low, high]))
    return lo, max(hi, lo + 1e-3)


def in_unit(value: float | NDArray[np.float64], unit: Shade) -> float:
    """A temperature of a model (°C, or counts) in the unit that a person chose; counts stay counts."""
    return float({"°F": 1.8 * value + 32.0, "K": value + ZERO_CELSIUS_K}.get(unit, value))


def from_unit(value: float, unit: Shade) -> float:
    """The inverse of `in_unit`."""
    return {"°F": (value - 32.0) / 1.8, "K": value - ZERO_CELSIUS_K}.get(unit, value)


def difference_in_unit(value: float, unit: Shade) -> float:
    """A difference of temperatures, likewise."""
    return 1.8 * value if unit == "°F" else value


def _plain(size: tuple[int, int]) -> Picture:
    return np.full((*size, 3), NO_DATA, np.uint8)
