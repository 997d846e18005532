"""Pictures for people, made from arrays: colour maps with their bars, error maps, edge overlays.

Every picture is uint8 `[H, W, 3]` RGB. These are for screens only; nothing is ever computed from them.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from rtgs.base.files import write_whole

Picture = NDArray[np.uint8]

BACKGROUND = (22, 22, 26)
INK = (236, 236, 240)
NO_DATA = (110, 110, 116)
THERMAL_EDGE = (255, 64, 48)
RENDER_EDGE = (0, 210, 255)
COMMON_EDGE = (255, 255, 255)
_SMOOTH_PX = 2.0  # before edges are sought: less leaves the sensor's noise as edges
_SHORTEST_EDGE_PX = 8


def to_picture(image: NDArray) -> Picture:
    """RGB or gray `[H, W]`, `[H, W, 1]`, `[H, W, 3]` float in [0, 1] (clipped; NaN is black) as uint8 `[H, W, 3]`."""
    image = np.nan_to_num(np.asarray(image, dtype=np.float32))
    if image.ndim == 2:
        image = image[..., None]
    if image.ndim != 3 or image.shape[2] not in (1, 3):
        raise ValueError(f"a picture is made from [H, W], [H, W, 1] or [H, W, 3]; got {image.shape}")
    return np.repeat((np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8), 3 // image.shape[2], axis=2)


def palette(temperature: NDArray, lo: float, hi: float, name: str = "inferno") -> Picture:
    """Colour a map: `lo` and below take the first colour, `hi` and above the last, NaN a neutral gray.

    Args:
        temperature: `[H, W]`, °C (or whatever `lo` and `hi` are in).
        lo, hi: ends of the colour map, `lo < hi`.
        name: a matplotlib colour map.

    Raises:
        ValueError: not `[H, W]`, `lo ≥ hi`, or no such colour map.
    """
    temperature = np.asarray(temperature, dtype=np.float64)
    if temperature.ndim != 2:
        raise ValueError(f"palette colours a map [H, W]; got {temperature.shape}")
    _check_range(lo, hi)
    known = np.isfinite(temperature)
    level = np.clip((np.where(known, temperature, lo) - lo) / (hi - lo), 0, 1)
    index = np.rint(level * 255).astype(np.uint8)
    return np.where(known[..., None], _colours(name)[index], np.array(NO_DATA, np.uint8))


def with_colour_bar(picture: Picture, lo: float, hi: float, unit: str = "°C", name: str = "inferno") -> Picture:
    """The picture with a labelled bar of `name`'s colours from `lo` (bottom) to `hi` (top) at its right: `[H, W + bar, 3]`."""
    _check_range(lo, hi)
    height = picture.shape[0]
    size = _text_size(height)
    font = _font(size)
    ticks = _ticks(lo, hi, max(2, min(6, height // (3 * size))))
    decimals = max(0, -int(np.floor(np.log10(ticks[1] - ticks[0]))))
    labels = [f"{t:.{decimals}f}" for t in ticks]
    top = int(1.6 * size) if unit else size  # the unit stands above the bar
    bar_height, bar_width = max(2, height - top - size), max(8, int(0.9 * size))
    text_width = max(int(np.ceil(font.getlength(text))) for text in [*labels, unit])
    gap = size // 2
    strip = Image.new("RGB", (bar_width + text_width + 4 * gap, height), BACKGROUND)
    bar = _colours(name)[np.rint(np.linspace(255, 0, bar_height)).astype(int)][:, None].repeat(bar_width, axis=1)
    strip.paste(Image.fromarray(bar), (gap, top))
    draw = ImageDraw.Draw(strip)
    if unit:
        draw.text((gap, 0.75 * size), unit, fill=INK, font=font, anchor="lm")
    for tick, text in zip(ticks, labels, strict=True):
        y = top + (hi - tick) / (hi - lo) * (bar_height - 1)
        draw.line([(gap + bar_width, y), (gap + bar_width + gap // 2, y)], fill=INK)
        draw.text((2 * gap + bar_width, y), text, fill=INK, font=font, anchor="lm")
    return np.concatenate([picture, np.asarray(strip)], axis=1)


def error_map(render: NDArray, reference: NDArray, limit: float, unit: str = "") -> Picture:
    """Where a render is wrong, with its bar.

    A map `[H, W]` gives the signed difference `render − reference` from −limit (blue: too cold) over white to +limit (red: too
    warm). An image `[H, W, C]` gives the mean absolute difference over channels from 0 to `limit`. NaN is a neutral gray.

    Raises:
        ValueError: shapes differ, or `limit` is not positive.
    """
    if render.shape != reference.shape or render.ndim not in (2, 3):
        raise ValueError(f"error_map compares two [H, W] or [H, W, C] of one shape; got {render.shape} and {reference.shape}")
    if not limit > 0:
        raise ValueError(f"error_map's limit must be positive; got {limit}")
    difference = render.astype(np.float64) - reference.astype(np.float64)
    if difference.ndim == 2:
        return with_colour_bar(palette(difference, -limit, limit, "coolwarm"), -limit, limit, unit, "coolwarm")
    return with_colour_bar(palette(np.abs(difference).mean(axis=2), 0, limit, "magma"), 0, limit, unit, "magma")


def edge_overlay(gray: NDArray, thermal: NDArray, mask: NDArray[np.bool_] | None = None) -> Picture:
    """Whether the edges of a gray render meet those of a thermal image: what the scale is judged by, made visible.

    The dimmed render is the ground; thermal edges are red, render edges cyan, and both are white where they meet to a pixel.

    Args:
        gray: `[H, W]` in [0, 1], the RGB model rendered from the thermal camera.
        thermal: `[H, W]`, any unit: only its gradients count.
        mask: `[H, W]` bool, valid thermal pixels; no edge is drawn within 2 px of an invalid one.
    """
    if gray.shape != thermal.shape or gray.ndim != 2:
        raise ValueError(f"edge_overlay takes two [H, W] of one shape; got {gray.shape} and {thermal.shape}")
    valid = np.isfinite(thermal) & np.isfinite(gray)
    if mask is not None:
        valid &= mask
    inside = cv2.erode(valid.astype(np.uint8), np.ones((5, 5), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=1) > 0
    of_render, of_thermal = _edges(gray, inside), _edges(thermal, inside)
    out = to_picture(0.45 * np.asarray(gray, dtype=np.float32))
    near = np.ones((3, 3), np.uint8)
    near_render = cv2.dilate(of_render.astype(np.uint8), near) > 0
    near_thermal = cv2.dilate(of_thermal.astype(np.uint8), near) > 0
    out[of_render] = RENDER_EDGE
    out[of_thermal] = THERMAL_EDGE
    out[(of_render & near_thermal) | (of_thermal & near_render)] = COMMON_EDGE
    return out


def side_by_side(pictures: Sequence[Picture], labels: Sequence[str]) -> Picture:
    """Pictures in a row, brought to the tallest one's height, each under its label: `[H + label, ΣW + gaps, 3]`."""
    if not pictures or len(pictures) != len(labels):
        raise ValueError(f"side_by_side needs one label a picture; got {len(pictures)} and {len(labels)}")
    height = max(p.shape[0] for p in pictures)
    size = _text_size(height)
    gap = size // 2
    tiles = [Image.fromarray(p) for p in pictures]
    tiles = [t if t.height == height else t.resize((max(1, round(t.width * height / t.height)), height)) for t in tiles]
    canvas = Image.new("RGB", (sum(t.width for t in tiles) + gap * (len(tiles) - 1), height + 2 * size), BACKGROUND)
    draw = ImageDraw.Draw(canvas)
    x = 0
    for tile, label in zip(tiles, labels, strict=True):
        canvas.paste(tile, (x, 2 * size))
        draw.text((x + gap, size), label, fill=INK, font=_font(size), anchor="lm")
        x += tile.width + gap
    return np.asarray(canvas)


def save_png(path: Path, picture: Picture) -> None:
    """Write uint8 `[H, W]` or `[H, W, 3]`; `path` appears whole or not at all. Its folder is made."""
    _save(Path(path), picture, "PNG")


def save_tiff(path: Path, values: NDArray) -> None:
    """Write counts, temperatures or depths `[H, W]` as they are; `path` appears whole or not at all. Its folder is made."""
    _save(path, values, "TIFF")


def _save(path: Path, values: NDArray, file_format: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    Image.fromarray(values).save(buffer, format=file_format)  # to a file, Pillow overlooks a write that a full disk cuts short
    with write_whole(path) as temporary:
        temporary.write_bytes(buffer.getbuffer())


def _edges(image: NDArray, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """One-pixel ridges of the Sobel gradient magnitude, strongest tenth, `[H, W]`."""
    if not inside.any():
        return np.zeros(image.shape, dtype=bool)
    middle = np.median(image[inside])  # taken off first: filtering a flat 300 K image in float32 would leave rounding as edges
    filled = np.where(np.isfinite(image), image - middle, 0.0).astype(np.float32)
    smooth = cv2.GaussianBlur(filled, (0, 0), _SMOOTH_PX)
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    magnitude = np.hypot(gx, gy)
    # The percentile keeps the amount of ink alike from scene to scene; the mean keeps it to true peaks where most of it is flat.
    threshold = max(float(np.percentile(magnitude[inside], 90)), float(magnitude[inside].mean()))
    # Thinning: a ridge pixel is no smaller than its two neighbours along the gradient, whose direction is rounded to 45°.
    octant = np.rint(np.arctan2(gy, gx) / (np.pi / 4)).astype(int) % 4
    padded = np.pad(magnitude, 1, mode="edge")
    h, w = magnitude.shape
    ridge = np.zeros((h, w), dtype=bool)
    for k, (dx, dy) in enumerate(((1, 0), (1, 1), (0, 1), (-1, 1))):
        ahead = padded[1 + dy : 1 + dy + h, 1 + dx : 1 + dx + w]
        behind = padded[1 - dy : 1 - dy + h, 1 - dx : 1 - dx + w]
        # Strict on one side only: a plateau two pixels wide, as a symmetric step gives, keeps one of them.
        ridge |= (octant == k) & (magnitude >= ahead) & (magnitude > behind)
    ridge &= inside & (magnitude > threshold)
    _, label, stats, _ = cv2.connectedComponentsWithStats(ridge.astype(np.uint8), connectivity=8)
    long_enough = stats[:, cv2.CC_STAT_AREA] >= _SHORTEST_EDGE_PX  # shorter ones are noise, and would be what the eye sees first
    long_enough[0] = False  # the background's component
    return long_enough[label]


def _check_range(lo: float, hi: float) -> None:
    if not (np.isfinite(lo) and np.isfinite(hi) and lo < hi):
        raise ValueError(f"a colour range needs lo < hi, both finite; got {lo} and {hi}")


def _ticks(lo: float, hi: float, at_most: int) -> NDArray[np.float64]:
    """Two to `at_most` evenly spaced numbers in [lo, hi]: multiples of 1, 2 or 5 times a power of ten."""
    exponent = int(np.floor(np.log10((hi - lo) / at_most)))
    ticks = np.array([lo, hi])
    for step in (m * 10.0**e for e in (exponent, exponent + 1) for m in (1, 2, 5)):
        found = np.arange(np.ceil(lo / step - 1e-9), np.floor(hi / step + 1e-9) + 1) * step + 0.0  # + 0.0: no "-0"
        if 2 <= len(found) <= at_most:
            return found
        if len(found) > at_most:
            ticks = found[:: len(found) - 1]
    return ticks


@lru_cache(maxsize=16)
def _colours(name: str) -> NDArray[np.uint8]:
    """`[256, 3]`."""
    try:
        colour_map = matplotlib.colormaps[name]
    except KeyError:
        raise ValueError(f"no colour map is called '{name}'; see matplotlib's list") from None
    return (colour_map(np.linspace(0, 1, 256))[:, :3] * 255 + 0.5).astype(np.uint8)


def _text_size(height: int) -> int:
    return int(np.clip(height // 24, 10, 28))


@lru_cache(maxsize=16)
def _font(size: int) -> ImageFont.FreeTypeFont:
    # matplotlib ships this one, so it is there on every machine and it knows the degree sign.
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"), size)
