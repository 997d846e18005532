"""Numeric settings, found by reflection, and numbers just outside of their ranges."""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Iterator
from typing import Any

import rtgs.config
from rtgs.config import BoardConfig, RunConfig, TagsConfig
from rtgs.config.ranges import Range, ranges_of

CONFIGS = [c for name in rtgs.config.__all__ for c in [getattr(rtgs.config, name)] if dataclasses.is_dataclass(c)]

# What has no default, where the other settings are examined.
NEEDED: dict[type, dict[str, Any]] = {BoardConfig: {"inner_corners": "6x5", "square_m": 0.1}, TagsConfig: {"side_m": 0.1}}


def kinds(hint: Any) -> set[type]:
    """int and float, where they occur in a type."""
    inner = [kinds(part) for part in typing.get_args(hint) if not isinstance(part, str | Range)]
    return ({hint} & {int, float}).union(*inner)


NUMERIC = [(c, name) for c in CONFIGS for name, hint in typing.get_type_hints(c).items() if kinds(hint)]


def with_number(hint: Any, value: float, second: bool) -> Any:
    """The value, in the tuple that the type asks for."""
    if typing.get_origin(hint) is tuple:
        parts = [a for a in typing.get_args(hint) if a is not Ellipsis]
        if typing.get_origin(parts[0]) is tuple:
            return ((0.5, value),) if second else ((value, 2),)
        return tuple([value] * len(parts))
    tuples = [a for a in typing.get_args(hint) if typing.get_origin(a) is tuple]
    return with_number(tuples[0], value, second) if tuples else value


def outside(allowed: Range) -> Iterator[float]:
    """Numbers just outside of a range."""
    yield from (math.nan, math.inf, -math.inf)
    yield from (limit for limit in (allowed.above, allowed.below) if limit is not None)
    if allowed.least is not None:
        yield allowed.least - 1
    if allowed.most is not None:
        yield allowed.most + 1


def refused_flags(settings: Any = None, prefix: str = "--") -> Iterator[list[str]]:
    """For every numeric setting of a run, its flag with each number that is not allowed: NaN, infinity, and beyond each end."""
    settings = RunConfig() if settings is None else settings
    config: Any = type(settings)
    hints = typing.get_type_hints(config)
    for field in dataclasses.fields(settings):
        flag, value = prefix + field.name.replace("_", "-"), getattr(settings, field.name)
        if dataclasses.is_dataclass(value):
            yield from refused_flags(value, f"{flag}.")
        elif field.name in ranges_of(config):
            for number in outside(ranges_of(config)[field.name]):
                yield [flag, *(f"{x:.12g}" for x in _flat(with_number(hints[field.name], number, False)))]


def _flat(value: Any) -> list[float]:
    return [x for part in value for x in _flat(part)] if isinstance(value, tuple) else [value]
