"""Section: the list of hot and cold spots, and pictures of the strongest."""

from __future__ import annotations

import html
import shlex

from rtgs.records.spots import Spot, SpotList
from rtgs.run.report.pieces import figure, missing, section
from rtgs.run.report.run_records import RunRecords
from rtgs.run.report.values import amount, area, length, position

MOST_LISTED = 20
MOST_PICTURES = 6
_TITLE = "Hot and cold spots"


def spots_section(run: RunRecords) -> str:
    """The strongest spots as a table, and RGB and thermal photograph of each of the first."""
    found = run.spots
    if found is None:
        return section(_TITLE, _counts(run) if run.unit == "counts" else missing(run, "list of hot and cold spots"))
    count = {0: "No spot is", 1: "1 spot is"}.get(len(found.spots), f"{len(found.spots)} spots are")
    said = f"<p>{count} {html.escape(found.criterion)}.{_folder(run, found)}</p>"
    if not found.spots:
        return section(_TITLE, said)
    notes = (
        "<p>± is one standard error. Temperatures are medians over the training photographs that show the place; “of 9” counts those "
        "that see it. Positions are in the frame of the poses.</p>"
    )
    return section(_TITLE, said + _table(found) + notes + _reference(found) + _pictures(run, found))


def _reference(found: SpotList) -> str:
    """What differences refer to; "" where to nothing."""
    reference = found.reference
    if reference is None:
        return ""
    name = html.escape(reference.name or "The reference")
    if reference.std is None:
        return f"<p>{name}: {amount(reference.temperature, found.unit)}, as stated.</p>"
    value = f"{amount(reference.temperature, found.unit, 2)} ±\u00a0{reference.std:.2f}"
    views = "1 photograph sees" if reference.views == 1 else f"{reference.views} photographs see"
    return f"<p>{name}: {value}, as the model shows it; {views} it, and ± is how far the model is off them.</p>"


def _counts(run: RunRecords) -> str:
    out = run.path / "spots"
    command = f"rtgs spots {shlex.quote(str(run.path))} --out {shlex.quote(str(out))} --excess COUNTS"
    return f"<p class='missing'>The capture has no temperatures. To list spots in counts: <code>{html.escape(command)}</code></p>"


def _folder(run: RunRecords, found: SpotList) -> str:
    more = f" The strongest {MOST_LISTED} are shown." if len(found.spots) > MOST_LISTED else ""
    path = html.escape(str(run.path / "spots")).replace("/", "/<wbr>")
    return f"{more} All figures, places for maps and pictures: <code>{path}</code>"


def _table(found: SpotList) -> str:
    columns = ["No.", "Kind", "Temperature", "ΔT to surroundings", "Extent", f"Position ({found.length_unit})", "Photographs"]
    if found.reference is not None:
        columns.insert(4, f"ΔT to {found.reference.name or 'reference'}")
    head = "".join(f"<th>{html.escape(column)}</th>" for column in columns)
    rows = "".join(_row(number, spot, found, columns) for number, spot in enumerate(found.spots[:MOST_LISTED], start=1))
    return f'<div class="wide"><table class="spots stacked"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>'


def _row(number: int, spot: Spot, found: SpotList, columns: list[str]) -> str:
    unit = found.unit
    extreme = amount(spot.extreme, unit) + ("" if spot.std is None else f" ±\u00a0{spot.std:.2f}")
    if spot.model_differs:
        extreme += f"; the model shows {amount(spot.modelled, unit)}"
    extent = f"{area(spot.area_m2)}, Ø\u00a0{length(spot.diameter_m)}"
    if found.length_unit != "m":
        extent = f"Ø\u00a0{spot.diameter_m:.3g}\u00a0{found.length_unit}"
    cells = [str(number), spot.kind, extreme, amount(spot.excess, unit, difference=True), extent]
    off = found.off_reference(spot)
    if off is not None:
        cells.insert(4, amount(off, unit, difference=True))
    cells += [position(spot.position_m), f"{spot.views} of {spot.seen_by}"]
    # The heading of each cell stands in front of it where the screen is too narrow for columns.
    named = zip(columns, cells, strict=True)
    return "<tr>" + "".join(f'<td data-column="{html.escape(c)}">{html.escape(cell)}</td>' for c, cell in named) + "</tr>"


def _pictures(run: RunRecords, found: SpotList) -> str:
    figures = ""
    for number, spot in enumerate(found.spots[:MOST_PICTURES], start=1):
        caption = f"{number}: {spot.kind}, {amount(spot.extreme, found.unit)}. RGB and thermal photograph at one scale"
        figures += figure(run.path / "spots" / "spots" / f"{number:03d}.png", caption, made_by="rtgs spots")
    return f'<div class="pair">{figures}</div>' if figures else ""
