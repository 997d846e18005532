"""Changes of JSON documents: values of other types and sizes, keys that come and go, and numbers that no program writes."""

from __future__ import annotations

import json
import re
from random import Random
from typing import Any

from tests.fuzz.mutate import of_bytes


def of_json(rng: Random, data: bytes) -> bytes:
    """Values of other types and sizes, keys that come and go; now and then what Python's writer would not write."""
    if rng.random() < 0.1:
        return of_bytes(rng, data)
    document = json.loads(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        document = _odd_document(rng, document)
    text = json.dumps(document)
    if rng.random() < 0.3:  # a number or a word as text
        numbers = list(re.finditer(r"-?\d+(\.\d+)?(e-?\d+)?|true|null", text))
        if numbers:
            chosen = rng.choice(numbers)
            text = text[: chosen.start()] + rng.choice(_ODD_TOKENS) + text[chosen.end() :]
    return (("\ufeff" if rng.random() < 0.03 else "") + text).encode("utf-8", "surrogatepass")


_ODD_TOKENS = (
    *("9" * 400, "-" + "9" * 400, "1" + "0" * 5000, "[" * 3000 + "]" * 3000, "[" * 100_000, '{"a":' * 2000 + "1" + "}" * 2000),
    *("1e400", "NaN", "Infinity", "-Infinity", "1.5", "0.1e-400", "9223372036854775808", "1e308", "-0.0"),
    *('""', "'a'", "1_000", "0x10", "01", "+1", ".5", "[1,]", '"\\ud800"', '"\\u0000"', '"\n"'),
)


def _odd_value(rng: Random, old: Any) -> Any:
    numbers = (0, 1, -1, 2, 1.5, -0.5, 1e308, -1e308, 1e-320, 10**400, 2**63, 2**31, float("nan"), float("inf"))
    texts = ("", "x", "nan", "1", "ä" * 300, "../../../etc/passwd", "/", "\0", "\ud800", "a\nb", str(old))
    others: tuple[Any, ...] = (None, True, False, [], {}, [[]], [None], {"": None}, [0] * 1000, [old], {"a": old}, [old, old])
    kinds: tuple[Any, ...] = (*numbers, *texts, *others)
    if isinstance(old, int | float) and not isinstance(old, bool) and abs(old) < 1e300:
        kinds += (old + 1, -old, old * 1e6, old * 1e-6, old + 0.5, str(old), [old])
    if isinstance(old, list) and old:
        kinds += (old[:-1], [*old, old[-1]], old[::-1], dict(enumerate(old)), old[0])
    return rng.choice(kinds)


def _odd_document(rng: Random, value: Any) -> Any:
    """The document with one value replaced, one key changed, or one item taken away."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = rng.choice(list(value))
        kind = rng.random()
        if kind < 0.06:
            return {k: v for k, v in value.items() if k != key}
        if kind < 0.1:
            return {rng.choice(("", "x", key.upper(), key + " ", "\ud800", "ä")) if k == key else k: v for k, v in value.items()}
        if kind < 0.14:
            return {**value, rng.choice(("x", "", "unknown", key + "_")): _odd_value(rng, value[key])}
        return {**value, key: _odd_document(rng, value[key])}
    if isinstance(value, list) and value and rng.random() < 0.8:
        i = rng.randrange(len(value))
        if rng.random() < 0.1:
            return value[:i] + value[i + 1 :]
        return [*value[:i], _odd_document(rng, value[i]), *value[i + 1 :]]
    return _odd_value(rng, value)
