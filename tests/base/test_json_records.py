"""The codec of records: what is written is read back the same, and what does not fit is refused by file and field."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import from_json, read_record, to_json, write_json


@dataclass(frozen=True)
class Point:
    x: float
    y: float


@dataclass(frozen=True)
class Circle:
    centre: Point
    radius: float


@dataclass(frozen=True)
class Drawing:
    name: str
    shape: Point | Circle
    count: int = 0
    closed: bool = False
    kind: Literal["ink", "pencil"] = "ink"
    file: Path | None = None
    size: tuple[float, float] = (1.0, 1.0)
    points: tuple[Point, ...] = ()
    weights: Sequence[float] = ()
    named: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    anything: Any = None


FULL = Drawing(
    "Käfer",
    Circle(Point(1.0, -2.5), 3.0),
    count=2,
    closed=True,
    kind="pencil",
    file=Path("a/b.ply"),
    size=(0.1, 2.0),
    points=(Point(0.0, 0.0), Point(1.0, 1.0)),
    weights=[0.5, 0.25],
    named={"a": (1.0, 2.0)},
    anything={"free": [1, None]},
)


@pytest.mark.parametrize("drawing", [FULL, Drawing("small", Point(0.0, 1.0))])
def test_what_is_written_is_read_back_the_same(drawing: Drawing, tmp_path: Path) -> None:
    write_json(tmp_path / "drawing.json", drawing)
    again = read_record(Drawing, tmp_path / "drawing.json")
    assert to_json(again) == to_json(drawing)
    assert (again.shape, again.points, again.file, again.named) == (drawing.shape, drawing.points, drawing.file, drawing.named)
    assert drawing.name in (tmp_path / "drawing.json").read_text(encoding="utf-8")  # and not as escapes


def test_of_several_records_the_one_with_these_fields_is_read() -> None:
    for shape in (Point(1.0, 2.0), Circle(Point(1.0, 2.0), 3.0)):
        assert from_json(Drawing, to_json(Drawing("a", shape)), "here").shape == shape


def test_whole_numbers_are_floats_where_floats_are_expected() -> None:
    point = from_json(Point, {"x": 1, "y": 2.5}, "here")
    assert point == Point(1.0, 2.5) and type(point.x) is float


def test_arrays_become_lists() -> None:
    assert to_json({"a": np.arange(3), "b": np.float32(0.5), 3: (1, 2)}) == {"a": [0, 1, 2], "b": 0.5, "3": [1, 2]}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"colour": "red"}, "unknown field 'colour' of Drawing"),
        ({"count": 1.5}, "field 'count' of Drawing is 1.5"),
        ({"count": True}, "field 'count'"),
        ({"closed": 1}, "field 'closed'"),
        ({"kind": "chalk"}, "field 'kind'"),
        ({"size": [1.0]}, "field 'size'"),
        ({"size": 1.0}, "field 'size'"),
        ({"points": [{"x": 1.0}]}, "field 'y' of Point is missing"),
        ({"shape": {"x": "left", "y": 0.0}}, "field 'x' of Point"),
        ({"shape": 7}, "Point is 7; a JSON object is expected"),
        ({"weights": ["a"]}, "field 'weights'"),
        ({"named": [1.0]}, "field 'named'"),
        ({"file": 3}, "field 'file'"),
        ({"name": None}, "field 'name'"),
    ],
)
def test_what_does_not_fit_is_refused_by_file_and_field(change: dict[str, Any], said: str, tmp_path: Path) -> None:
    path = tmp_path / "drawing.json"
    path.write_text(json.dumps({**to_json(FULL), **change}), encoding="utf-8")
    with pytest.raises(RtgsError, match=said) as refused:
        read_record(Drawing, path)
    assert str(path) in str(refused.value) and "Remove it and run again" in str(refused.value)


@pytest.mark.parametrize(("text", "said"), [("{ no JSON", "unreadable"), ("[]", "a JSON object is expected"), (None, "missing")])
def test_files_that_are_no_record(text: str | None, said: str, tmp_path: Path) -> None:
    path = tmp_path / "drawing.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(RtgsError, match=said) as refused:
        read_record(Drawing, path)
    assert str(path) in str(refused.value)


def test_what_json_cannot_hold_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "point.json"
    write_json(path, Point(1.0, 2.0))
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, Point(float("nan"), 0.0))
    assert read_record(Point, path) == Point(1.0, 2.0) and [p.name for p in tmp_path.iterdir()] == ["point.json"]
