"""The colour bar of a view, as a piece of the page."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from rtgs.images.pictures import palette
from rtgs.viewer.picture import ISOTHERM, Look, Shade, in_unit

_STOPS = 24


def colour_bar(look: Look, unit: Shade) -> str:
    """HTML of a horizontal bar from `look.lo` to `look.hi`, labelled in a person's unit."""
    ticks = _ticks(in_unit(look.lo, unit), in_unit(look.hi, unit))
    ends = in_unit(look.lo, unit), in_unit(look.hi, unit)

    def at(value: float) -> float:
        return 100 * (value - ends[0]) / (ends[1] - ends[0])

    marks = "".join(
        f'<span style="position:absolute;left:{at(t):.2f}%;transform:translateX(-50%)">{_text(t, ticks)}</span>' for t in ticks
    )
    band = ""
    if look.isotherm is not None:
        lo, hi = (float(np.clip(at(in_unit(t, unit)), 0, 100)) for t in look.isotherm)
        band = (
            f'<div style="position:absolute;left:{lo:.2f}%;width:{max(hi - lo, 0.6):.2f}%;top:0;bottom:0;'
            f'background:rgb{ISOTHERM};opacity:.95"></div>'
        )
    return (
        '<div class="rtgs-legend" style="padding:2px 24px 10px;font-size:12px">'
        f'<div style="display:flex;justify-content:space-between;opacity:.75"><span>temperature</span><span>{unit}</span></div>'
        f'<div style="position:relative;height:14px;border-radius:3px;overflow:hidden;background:{_gradient(look.palette)}">{band}</div>'
        f'<div style="position:relative;height:16px;margin-top:2px">{marks}</div></div>'
    )


@lru_cache(maxsize=16)
def _gradient(name: str) -> str:
    row = palette(np.linspace(0, 1, _STOPS)[None], 0, 1, name)[0]
    return "linear-gradient(90deg," + ",".join(f"rgb({r},{g},{b})" for r, g, b in row.tolist()) + ")"


def _ticks(lo: float, hi: float, most: int = 6) -> list[float]:
    """Up to so many round numbers in [lo, hi], and the ends where there is none."""
    step = 10.0 ** math.floor(math.log10(max(hi - lo, 1e-9) / most))
    for factor in (1, 2, 5, 10, 20):
        first = math.ceil(lo / (factor * step) - 1e-9)
        found = [n * factor * step for n in range(first, math.floor(hi / (factor * step) + 1e-9) + 1)]
        if len(found) <= most:
            return found or [lo, hi]
    return [lo, hi]


def _text(tick: float, ticks: list[float]) -> str:
    step = abs(ticks[1] - ticks[0]) if len(ticks) > 1 else 1.0
    return f"{tick:.{max(0, -math.floor(math.log10(max(step, 1e-9)) + 1e-9))}f}"
