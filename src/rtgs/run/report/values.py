"""Numbers as the report shows them, and which frames it shows."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rtgs.metrics.scores import SCORES
from rtgs.records.radiometry import Unit


def metric(name: str, value: float | None) -> str:
    """A score without its unit; a dash where there is none."""
    return "–" if value is None else SCORES[name].number(value)


def signed_metric(name: str, difference: float | None) -> str:
    """A difference of two scores, with its sign."""
    return "–" if difference is None else minus(f"{difference:+.{SCORES[name].decimals}f}")


def minus(number: str) -> str:
    """With the minus sign of typography in place of the hyphen."""
    return number.replace("-", "−")


def size(width_height: tuple[int, int]) -> str:
    """ "640 × 512 px"."""
    return f"{width_height[0]} × {width_height[1]} px"


def length(metres: float) -> str:
    """With three digits, in m, cm or mm."""
    value, unit = (metres, "m") if metres >= 1 else (100 * metres, "cm") if metres >= 0.01 else (1000 * metres, "mm")
    return f"{value:.3g}\u00a0{unit}"


def area(square_metres: float) -> str:
    """With three digits, in m² or cm²."""
    value, unit = (square_metres, "m²") if square_metres >= 1 else (1e4 * square_metres, "cm²")
    return f"{float(f'{value:.3g}'):g}\u00a0{unit}"


def amount(value: float, unit: Unit, decimals: int = 1, *, difference: bool = False) -> str:
    """A temperature, or a difference of two with its sign: "21.3 °C", "+4.2 K"."""
    shown = "K" if difference and unit == "°C" else unit
    return minus(f"{value:{'+' if difference else ''}.{decimals}f}") + f"\u00a0{shown}"


def position(place: Sequence[float]) -> str:
    """To a hundredth: "0.61, −2.00, 0.00"."""
    return ", ".join(minus(f"{round(v, 2) + 0.0:.2f}") for v in place)  # + 0.0: no "-0"


def duration(seconds: float) -> str:
    """ "4.2 s", "3 min 05 s" or "2 h 07 min"."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def evenly(count: int, at_most: int) -> Sequence[int]:
    """Up to `at_most` of the indices 0 … count − 1, the first and the last among them."""
    if count <= at_most:
        return range(count)
    return [round(i * (count - 1) / (at_most - 1)) for i in range(at_most)]


def flattened(settings: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, str]]:
    """Nested settings as (dotted name, value in words)."""
    for key, value in settings.items():
        if isinstance(value, dict) and value:
            yield from flattened(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
