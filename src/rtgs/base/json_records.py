"""Records and settings as JSON, and back with their types checked: the one codec of every JSON file that this package writes."""

from __future__ import annotations

import dataclasses
import json
import math
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar, Union

from rtgs.base.errors import RtgsError
from rtgs.base.files import write_text_whole

T = TypeVar("T")

DEEPEST = 50  # levels of brackets in a file; those of this package have fewer than ten
RUN_MAKES_IT = "`rtgs run` on this folder makes it."
RUN_AGAIN = "Remove it and run again."


def to_json(value: Any) -> Any:
    """A record, mapping, sequence, array or path as what JSON has.

    A record may name properties in a class variable `JSON_PROPERTIES`. They are written after its fields, for other programs to read;
    `from_json` leaves them out, since they follow from the fields.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [*(f.name for f in dataclasses.fields(value)), *_properties(type(value))]
        return {name: to_json(getattr(value, name)) for name in names}
    if isinstance(value, Mapping):
        return {str(k): to_json(v) for k, v in value.items()}
    if hasattr(value, "tolist"):  # an array; NumPy is not imported here, which the command line waits for
        return value.tolist()
    if isinstance(value, tuple | list):
        return [to_json(v) for v in value]
    return str(value) if isinstance(value, Path) else value


def from_json(cls: type[T], data: Any, where: str) -> T:
    """The inverse of `to_json` for a dataclass. Fields that the file does not name keep their defaults.

    Fields may be dataclasses, tuples, lists, sequences, mappings from text, unions with None, literals, paths, numbers and text.

    Args:
        where: the file, for messages.

    Raises:
        RtgsError: a field that this version does not know, one without a default that is missing, or a value of another type.
    """
    if not isinstance(data, dict):
        raise RtgsError(f"{where}: {cls.__name__} is {data!r:.100}; a JSON object is expected.")
    hints = typing.get_type_hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    data = {name: value for name, value in data.items() if name not in _properties(cls)}
    unknown = sorted(set(data) - set(fields))
    if unknown:
        raise RtgsError(f"{where}: unknown field {unknown[0]!r:.100} of {cls.__name__}; it was written by another version.")
    values = {}
    for name, value in data.items():
        try:
            values[name] = _value(hints[name], value, where)
        except (TypeError, ValueError):
            raise RtgsError(f"{where}: field {name!r} of {cls.__name__} is {value!r:.100}, which it cannot be.") from None
    missing = [n for n, f in fields.items() if n not in values and f.default is f.default_factory is dataclasses.MISSING]
    if missing:
        raise RtgsError(f"{where}: field {missing[0]!r} of {cls.__name__} is missing; it was written by another version.")
    try:
        return cls(**values)
    except RtgsError as error:  # a record that checks its fields does not know where they are from
        raise RtgsError(f"{where}: {error}") from None


def _value(hint: Any, value: Any, where: str) -> Any:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return value
    if origin in (Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        return _value(_alternative([a for a in arguments if a is not type(None)], value), value, where)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return from_json(hint, value, where)
    if origin is tuple:
        inner = arguments[:1] * len(value) if arguments[-1] is Ellipsis else arguments
        return tuple(_value(a, v, where) for a, v in zip(inner, _list(value), strict=True))
    if origin is not None and origin is not Literal and issubclass(origin, Mapping):
        if not isinstance(value, dict):
            raise TypeError
        return {k: _value(arguments[1], v, where) for k, v in value.items()}
    if origin is not None and origin is not Literal and issubclass(origin, Sequence):
        return [_value(arguments[0], v, where) for v in _list(value)]
    if hint is float and type(value) is int:
        return float(value)
    if hint is float and type(value) is float and not math.isfinite(value):
        raise ValueError
    if (value not in arguments) if origin is Literal else (type(value) is not (str if hint is Path else hint)):
        raise TypeError
    return Path(value) if hint is Path else value


def _properties(cls: type) -> Sequence[str]:
    return getattr(cls, "JSON_PROPERTIES", ())


def _alternative(hints: list[Any], value: Any) -> Any:
    """Of several types, the first record that has exactly these fields, or else the first type."""
    for hint in hints:
        if (
            isinstance(value, dict)
            and dataclasses.is_dataclass(hint)
            and {f.name for f in dataclasses.fields(hint)} == set(value)
        ):
            return hint
    return hints[0]


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise TypeError
    return value


def write_json(path: Path, value: Any) -> None:
    """A record (or what `to_json` takes) as a JSON file, whole or not at all.

    Raises:
        ValueError: a number that JSON does not have (NaN, infinity).
    """
    text = json.dumps(to_json(value), indent=1, ensure_ascii=False, allow_nan=False)
    write_text_whole(path, text + "\n")


def read_record(cls: type[T], path: Path, *, missing: str = RUN_MAKES_IT, remedy: str = RUN_AGAIN) -> T:
    """A record from its JSON file.

    Args:
        missing, remedy: as for `read_json`.

    Raises:
        RtgsError: the file is missing, no JSON, or not of this record.
    """
    data = read_json(path, missing=missing, remedy=remedy)
    try:
        return from_json(cls, data, str(path))
    except RtgsError as error:
        raise RtgsError(f"{error} {remedy}") from None


def read_json(path: Path, *, missing: str = RUN_MAKES_IT, remedy: str = RUN_AGAIN) -> Any:
    """What a JSON file holds, by `parse_json`.

    Args:
        missing: what to do where there is no such file.
        remedy: what to do about a damaged one.

    Raises:
        RtgsError: it is missing, cannot be opened, or is no JSON.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise RtgsError(f"{path}: no such file. {missing}") from None
    except UnicodeDecodeError as error:
        raise RtgsError(f"{path}: is not valid JSON ({error}). {remedy}") from error
    except OSError as error:
        raise RtgsError(f"{path}: cannot be read ({error.strerror}). {remedy}") from error
    try:
        return parse_json(text)
    except ValueError as error:
        raise RtgsError(f"{path}: is not valid JSON ({error!s:.300}). {remedy}") from error


def parse_json(text: str) -> Any:
    """A JSON document, within bounds that every user of it can rely on.

    Whole numbers have at most 63 bits; longer ones become floats, and infinity where a float cannot hold them. NaN and Infinity are read
    as Python's parser reads them: whoever wants a number names the field in which it is not finite.

    Raises:
        ValueError: no JSON, nested deeper than `DEEPEST`, or with text that is not Unicode.
    """
    too_deep = ValueError(f"its brackets are nested deeper than {DEEPEST} levels")
    try:
        document = json.loads(text, parse_int=_whole_number)
    except RecursionError:
        raise too_deep from None
    level = [document]
    for _ in range(DEEPEST + 1):
        texts = [key for value in level if isinstance(value, dict) for key in value]
        texts += [value for value in level if isinstance(value, str)]
        if any("\ud800" <= letter <= "\udfff" for some in texts if not some.isascii() for letter in some):
            raise ValueError("it holds half of a surrogate pair, which is no character")
        level = [inner for value in level for inner in _inside(value)]
        if not level:
            return document
    raise too_deep


def _whole_number(digits: str) -> int | float:
    number = int(digits) if len(digits) <= 20 else float(digits)
    return number if -(2**63) <= number < 2**63 else float(number)


def _inside(value: Any) -> Iterable[Any]:
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
