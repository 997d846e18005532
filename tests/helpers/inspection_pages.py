"""A made-up run with a list of spots and pictures, and a reader of the inspection report that comes of it."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from rtgs.base.json_records import write_json
from rtgs.images.pictures import save_png
from rtgs.records.spots import ReferenceTemperature, Spot, SpotList

SPOTS = SpotList(
    (
        Spot("hot", (1.2344, -2.0, 0.5), 0.0123, 46.04, 43.0, 20.0, 0.31, 7, 9, ("frame_0003", "frame_0001"), 41.0, 0.2),
        Spot("cold", (0.0, 3.0, -1.0), 1.5, 12.96, 14.0, 18.0, None, 1, 1, ("<b>7",), 13.0, None),
    ),
    "°C",
    "3 °C or more & <off>",
    ReferenceTemperature("", 18.0),
)


def write_spots(folder: Path, spots: SpotList = SPOTS) -> Path:
    """The folder as `rtgs spots` writes it."""
    folder.mkdir(parents=True)
    write_json(folder / "spots.json", spots)
    for number in range(1, len(spots.spots) + 1):
        save_png(folder / "spots" / f"{number:03d}.png", np.full((40, 90, 3), 40 * number % 256, np.uint8))
    return folder


class Report(HTMLParser):
    """What a person reads.

    Attributes:
        fields: title → value of each field outside of the findings' cards. empty: titles of those that are marked as empty.
        rows: the cells of the table of findings, by their columns' names.
        marks: numbers in the rendered pictures. images: sources of all pictures. tags: names of all elements.
    """

    VOID = frozenset({"meta", "img", "br", "wbr", "image", "circle"})

    def __init__(self, source: str) -> None:
        super().__init__()
        self.open: list[tuple[str, dict[str, str]]] = []
        self.words: list[str] = []
        self.fields: dict[str, str] = {}
        self.empty: list[str] = []
        self.headings: list[str] = []
        self.rows: list[dict[str, str]] = []
        self.marks: list[str] = []
        self.images: list[str] = []
        self.links: list[str] = []
        self.tags: set[str] = set()
        self._title = ""
        self.feed(source)
        assert not self.open, f"unclosed: {self.open}"
        self.text = " ".join(" ".join(self.words).split())
        self.fields = {name: " ".join(value.split()) for name, value in self.fields.items()}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {k: v or "" for k, v in attrs}
        self.tags.add(tag)
        self.links += [v for k, v in values.items() if k in ("src", "href", "xlink:href", "action", "data")]
        if tag in ("img", "image"):
            self.images.append(values.get("src") or values.get("href") or "")
        if tag not in self.VOID:
            self.open.append((tag, values))
        if tag == "dt":
            self._title = ""
        if tag == "tr" and any(v.get("class") == "findings" for _, v in self.open):
            self.rows.append({})
        if tag == "dd" and values.get("class") == "empty":
            self.empty.append(self._title)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop()[0] == tag

    def handle_data(self, data: str) -> None:
        names = [tag for tag, _ in self.open]
        if not names or names[-1] == "style":
            return
        self.words.append(data)
        if "dt" in names:
            self._title += data
        if "dd" in names and "article" not in names:
            self.fields[self._title] = self.fields.get(self._title, "") + data
        if names[-1] == "h2":
            self.headings.append(data)
        cell = next((v for tag, v in self.open if tag == "td" and "data-column" in v), None)
        if cell is not None:
            name = cell["data-column"]
            self.rows[-1][name] = (self.rows[-1].get(name, "") + data).replace("\u00a0", " ")
        if names[-1] == "text" and any(v.get("class") == "mark" for _, v in self.open):
            self.marks.append(data)


def report_of(path: Path) -> Report:
    """Read a page that was written."""
    return Report(path.read_text(encoding="utf-8"))
