"""The range of a numeric setting: written beside its type, checked here, and shown in `--help`.

    steps: Annotated[int, Range(1)] = 200

    def __post_init__(self) -> None:
        check_ranges(self, "scale")

None is in every range of a setting that may be None. NaN and infinity are in none.
"""

from __future__ import annotations

import typing
from collections.abc import Iterator
from functools import cache
from typing import Any

import tyro

from rtgs.base.errors import RtgsError


class SettingError(RtgsError):
    """A setting is out of its range. `name`: of the setting, as in "scale.steps"."""

    def __init__(self, name: str, text: str) -> None:
        super().__init__(f"{name} {text}")
        self.name, self.text = name, text


_Argument: Any = type(tyro.conf.arg())  # what tyro looks for beside a type


class Range(_Argument):
    """From `least`, or from above `above`, to `most`, or to below `below`. Of a tuple, every number is in the range.

    Args:
        then: the range of the second number of each pair, in a tuple of pairs.
    """

    def __init__(
        self,
        least: float | None = None,
        most: float | None = None,
        *,
        above: float | None = None,
        below: float | None = None,
        then: Range | None = None,
    ) -> None:
        super().__init__(**vars(tyro.conf.arg(help_behavior_hint=self._hint)))
        for name, value in (("least", least), ("most", most), ("above", above), ("below", below), ("then", then)):
            object.__setattr__(self, name, value)  # tyro's class is frozen

    def holds(self, value: float) -> bool:
        """Whether the number is finite and in the range; `then` is not looked at."""
        return (
            -1e300 < value < 1e300  # whole numbers may be larger than any float
            and (self.least is None or value >= self.least)
            and (self.most is None or value <= self.most)
            and (self.above is None or value > self.above)
            and (self.below is None or value < self.below)
        )

    def __str__(self) -> str:
        limits = [("at least", self.least), ("above", self.above), ("at most", self.most), ("below", self.below)]
        text = " and ".join(f"{word} {limit:,}".replace(",", " ") for word, limit in limits if limit is not None)
        return (text or "any finite number") + (f", then {self.then}" if self.then else "")

    def _hint(self, default: str) -> str:
        return f"(default: {default}; {self})"


def check_ranges(settings: Any, where: str = "") -> None:
    """Check all numbers of a record of settings.

    Args:
        where: the stage, for the message.

    Raises:
        SettingError: a number is out of its range.
    """
    for name, allowed in ranges_of(settings.__class__).items():
        for i, value in enumerate(_numbers(getattr(settings, name))):
            expected = allowed.then if allowed.then and i % 2 else allowed
            if not expected.holds(value):
                field = f"{where}.{name}" if where else name
                raise SettingError(field, f"is {value!s:.60}; it is {expected}.")


@cache
def ranges_of(settings: type) -> dict[str, Range]:
    """Range of each setting that has one, by name."""
    hints = typing.get_type_hints(settings, include_extras=True)
    found = {name: [r for r in getattr(hint, "__metadata__", ()) if isinstance(r, Range)] for name, hint in hints.items()}
    return {name: ranges[0] for name, ranges in found.items() if ranges}


def _numbers(value: Any) -> Iterator[float]:
    """The numbers in a number, None, or nested tuples."""
    if isinstance(value, tuple | list):
        for part in value:
            yield from _numbers(part)
    elif value is not None:
        yield value
