"""The way of records and settings to JSON and back."""

from __future__ import annotations

import dataclasses
import json
import types
import typing
from pathlib import Path
from typing import Any, Literal, TypeVar, Union

from rtgs.base.errors import RtgsError

T = TypeVar("T")


def to_json(config: Any) -> Any:
    """Nested dataclasses, paths and tuples as what JSON has."""
    if dataclasses.is_dataclass(config) and not isinstance(config, type):
        return {f.name: to_json(getattr(config, f.name)) for f in dataclasses.fields(config)}
    if isinstance(config, tuple | list):
        return [to_json(v) for v in config]
    return str(config) if isinstance(config, Path) else config


def from_json(cls: type[T], data: Any, where: str) -> T:
    """The inverse of `to_json`; settings that the file does not name keep their defaults.

    Args:
        where: the file, for messages.

    Raises:
        RtgsError: a setting this version does not know, or a value of another type.
    """
    hints = typing.get_type_hints(cls)
    if not isinstance(data, dict):
        raise RtgsError(f"{where}: {cls.__name__} is {data!r}; an object of settings is expected.")
    unknown = set(data) - set(hints)
    if unknown:
        raise RtgsError(f"{where}: unknown setting {sorted(unknown)[0]!r} of {cls.__name__}; it was written by another version.")
    values = {}
    for name, value in data.items():
        try:
            values[name] = _value(hints[name], value, where)
        except (TypeError, ValueError):
            raise RtgsError(f"{where}: setting {name!r} of {cls.__name__} is {value!r}, which it cannot be.") from None
    return cls(**values)


def _value(hint: Any, value: Any, where: str) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (Union, types.UnionType):
        return None if value is None else _value(next(a for a in arguments if a is not type(None)), value, where)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return from_json(hint, value, where)
    if origin is tuple:
        inner = arguments[:1] * len(value) if arguments[-1] is Ellipsis else arguments
        return tuple(_value(a, v, where) for a, v in zip(inner, value, strict=True))
    if hint is float and type(value) is int:
        return float(value)
    if (value not in arguments) if origin is Literal else (type(value) is not (str if hint is Path else hint)):
        raise TypeError
    return Path(value) if hint is Path else value


def read_run_json(path: Path) -> Any:
    """A JSON file of a run folder.

    Raises:
        RtgsError: it is missing, or no JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RtgsError(f"{path}: missing; `rtgs run` on this folder makes it.") from None
    except ValueError as error:
        raise RtgsError(f"{path}: unreadable ({error}); remove it and run again.") from error
