"""The file of facts, and the catalogue of texts."""

from __future__ import annotations

import json
import re
import string
from dataclasses import fields
from pathlib import Path

import pytest

import rtgs.run.inspection as package
from rtgs.base.errors import RtgsError
from rtgs.run.inspection import InspectionFacts, read_facts, write_empty_facts
from rtgs.run.inspection.facts import CameraFacts, OrderFacts, SeverityClass, WeatherFacts
from rtgs.run.inspection.words import Words


def test_an_empty_file_is_read_as_nothing_stated_and_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "new" / "facts.json"
    write_empty_facts(path)
    assert read_facts(path) == InspectionFacts()
    data = json.loads(path.read_text(encoding="utf-8"))
    assert data["order"]["client"] == "" and data["camera"]["emissivity"] is None and data["severity"] == []
    with pytest.raises(RtgsError, match="not overwritten"):
        write_empty_facts(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"order": {"clent": "x"}}', "clent"),
        ('{"camera": {"emissivity": 1.2}}', "camera.emissivity is 1.2; it is above 0 and at most 1"),
        ('{"weather": {"humidity_percent": -1}}', "weather.humidity_percent"),
        ('{"severity": [{"name": "A"}]}', "from_k"),
        ('{"severity": [{"name": "A", "from_k": 0}]}', "from_k is 0"),
        ('{"severity_of": "nothing"}', "severity_of"),
        ('{"order": {"client": 3}}', "client"),
        ("{", "facts.json"),
    ],
)
def test_what_cannot_be_read_is_refused_with_the_field(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "facts.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RtgsError, match=re.escape(said)) as error:
        read_facts(path)
    assert "facts.json" in str(error.value)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RtgsError, match="--write-facts"):
        read_facts(tmp_path / "facts.json")


@pytest.mark.parametrize(("difference", "name"), [(4.9, None), (5.0, "A"), (-12.0, "A"), (20.0, "B")])
def test_the_highest_class_that_is_reached(difference: float, name: str | None) -> None:
    found = InspectionFacts(severity=(SeverityClass("B", 20), SeverityClass("A", 5))).class_of(difference)
    assert (found.name if found else None) == name


def test_the_catalogue_has_a_title_for_every_field_and_no_text_is_left_over() -> None:
    texts = Words.load().texts
    for record in (OrderFacts, CameraFacts, WeatherFacts):
        assert not [f.name for f in fields(record) if f"field.{f.name}" not in texts]
    code = "\n".join(p.read_text(encoding="utf-8") for p in Path(package.__file__).parent.glob("*.py"))
    code = code.replace("'", '"')
    built = ("field.", "unit.", "section.", "column.", "kind.", "findings.severity_of.", "plan.up.", "plan.", "findings.axes.")
    for key, text in texts.items():
        string.Formatter().parse(text)
        assert f'"{key}"' in code or key.startswith(built) or key.removeprefix("findings.") + '"' in code, key


def test_a_text_is_escaped_with_its_values() -> None:
    assert Words({"a": "x < {y}"})("a", y="<b>") == "x &lt; &lt;b&gt;"
