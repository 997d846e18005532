"""Properties that a record writes beside its fields."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import ClassVar

import pytest

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import from_json, to_json


@dataclass(frozen=True)
class Square:
    JSON_PROPERTIES: ClassVar[tuple[str, ...]] = ("area",)

    side: float

    @property
    def area(self) -> float:
        return self.side**2


def test_properties_are_written_last_and_left_out_when_read() -> None:
    text = json.dumps(to_json(Square(3.0)))
    assert text == '{"side": 3.0, "area": 9.0}'
    assert from_json(Square, json.loads(text), "here") == from_json(Square, {"side": 3}, "here") == Square(3.0)
    assert from_json(Square, {"side": 2.0, "area": 1.0}, "here").area == 4.0  # it follows from the fields
    with pytest.raises(RtgsError, match="missing"):
        from_json(Square, {"area": 9.0}, "here")
