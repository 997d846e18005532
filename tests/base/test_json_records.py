"""The codec of records: what is written is read back the same, and what does not fit is refused by file and field."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtgs.base.errors import RtgsError
from rtgs.base.json_records import DEEPEST, from_json, parse_json, read_json, read_record, to_json, write_json


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


@pytest.mark.parametrize(
    ("text", "said"), [("{ no JSON", "is not valid JSON"), ("[]", "a JSON object is expected"), (None, "no such file")]
)
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


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 10**400, "1", None, [1.0], True])
def test_a_number_is_finite_and_a_number(value: Any) -> None:
    with pytest.raises(RtgsError, match="field 'x' of Point is"):
        from_json(Point, parse_json(json.dumps({"x": value, "y": 1.0})), "here")


def test_whole_numbers_have_63_bits() -> None:
    for number in (0, -1, 2**63 - 1, -(2**63), 10**18):
        assert parse_json(str(number)) == number and type(parse_json(str(number))) is int
    for number in (2**63, -(2**63) - 1, 10**40):
        assert parse_json(str(number)) == float(number) and type(parse_json(str(number))) is float
    assert parse_json("9" * 400) == math.inf == -parse_json("-" + "9" * 9000)


@pytest.mark.parametrize("levels", [DEEPEST, DEEPEST + 1, 900, 100_000])
@pytest.mark.parametrize(("opened", "closed"), [("[", "]"), ('{"a":', "}")])
def test_brackets_have_a_depth(levels: int, opened: str, closed: str) -> None:
    text = opened * levels + "0" + closed * levels
    if levels <= DEEPEST:
        parse_json(text)
    else:
        with pytest.raises(ValueError, match="nested deeper than 50 levels"):
            parse_json(text)


@pytest.mark.parametrize("text", ['"\\ud800"', '{"\\udfff": 1}', '[[{"a": ["x\\udabcy"]}]]'])
def test_text_is_unicode(text: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="surrogate"):
        parse_json(text)
    assert parse_json('"\\ud83d\\ude00"') == "😀"
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(RtgsError, match=r"a\.json: is not valid JSON .*surrogate.*Mend it"):
        read_json(tmp_path / "a.json", remedy="Mend it.")


def test_a_file_that_cannot_be_opened(tmp_path: Path) -> None:
    (tmp_path / "loop.json").symlink_to("loop.json")
    (tmp_path / "folder.json").mkdir()
    (tmp_path / "bytes.json").write_bytes(b'"\xff"')
    for name in ("loop", "folder", "bytes"):
        with pytest.raises(RtgsError, match=rf"{name}\.json: .*Mend it"):
            read_json(tmp_path / f"{name}.json", remedy="Mend it.")


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)


@given(st.sampled_from(sorted(to_json(FULL))), JSON)
@settings(max_examples=200, derandomize=True, deadline=None)
def test_any_value_for_any_field_is_read_back_the_same_or_refused(name: str, value: Any) -> None:
    document = parse_json(json.dumps({**to_json(FULL), name: value}))
    try:
        drawing = from_json(Drawing, document, "here")
    except RtgsError as refusal:
        assert "here" in str(refusal) and len(str(refusal)) < 1000
    else:
        assert from_json(Drawing, parse_json(json.dumps(to_json(drawing))), "here") == drawing or name == "anything"


@given(JSON)
@settings(max_examples=200, derandomize=True, deadline=None)
def test_any_document_is_parsed_or_no_json(value: Any) -> None:
    try:
        parse_json(json.dumps(value))
    except ValueError as error:
        assert str(error)
