"""Section: the findings as a table, and each of them with its pictures. Numbers are those of `spots.json`."""

from __future__ import annotations

import html
from pathlib import Path

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.records.spots import Spot, SpotList
from rtgs.run.inspection.facts import SeverityClass
from rtgs.run.inspection.inspection import Inspection
from rtgs.run.inspection.pieces import card, lines, paragraph, picture
from rtgs.run.report.pieces import read_picture
from rtgs.run.report.values import amount, area, length, minus, position

_PICTURE_PX = 760


def findings_section(report: Inspection) -> str:
    """The table, with what its numbers refer to; or that there is no list."""
    words, listed = report.words, report.spots
    if listed is None:
        return card(words, "findings", paragraph(words("findings.no_list", command=report.spots_command), "doubt"))
    if not listed.spots:
        return card(words, "findings", paragraph(words("findings.empty", criterion=listed.criterion)))
    count = "findings.count_one" if len(listed.spots) == 1 else "findings.count"
    said = paragraph(words(count, count=len(listed.spots), criterion=listed.criterion))
    if report.spots_are_older:
        said += paragraph(words("findings.older", command=report.spots_command), "doubt")
    return card(words, "findings", said + _table(report, listed) + lines(_notes(report, listed)) + _severity_table(report))


def _notes(report: Inspection, listed: SpotList) -> list[str]:
    words, facts = report.words, report.facts
    notes = [words("findings.std")]
    if listed.reference is None:
        notes.append(words("findings.no_reference"))
    else:
        reference = listed.reference
        what = reference.name or facts.reference or words.plain("findings.reference_unknown")
        if reference.std is None:
            notes.append(words("findings.reference", value=minus(f"{reference.temperature:g}"), unit=listed.unit, what=what))
        else:
            value = minus(f"{reference.temperature:.2f}") + f" ± {reference.std:.2f}"
            key = "findings.reference_measured_one" if reference.views == 1 else "findings.reference_measured"
            notes.append(words(key, value=value, unit=listed.unit, what=what, views=reference.views))
    notes.append(_axes(report))
    if not facts.severity:
        notes.append(words("findings.no_severity"))
    elif facts.severity_of == "reference" and listed.reference is None:
        notes.append(words("findings.severity_needs_reference"))
    else:
        notes.append(words(f"findings.severity_of.{facts.severity_of}"))
    return notes


def _axes(report: Inspection) -> str:
    frame = report.frame
    if frame is None or frame.axes is None:
        return report.words("findings.axes.given")
    if frame.place is None:
        return report.words("findings.axes.z-up")
    latitude, longitude = (f"{v:.7f}" for v in (frame.place.latitude_deg, frame.place.longitude_deg))
    return report.words("findings.axes.enu", latitude=latitude, longitude=longitude)


def position_of(report: Inspection, spot: Spot) -> tuple[float, float, float]:
    """Metres in the frame of the plan; that of the poses where there is none."""
    if report.frame is None or report.subject is None:
        return spot.position_m
    given = np.array(spot.position_m) / report.subject.unit_per_sfm
    x, y, z = report.frame.of(report.subject.scene.given_from_world.apply_inverse(given)).tolist()
    return x, y, z


def severity(report: Inspection, spot: Spot) -> SeverityClass | None:
    """Of the user's table; None without a table, without the reference it needs, and below all its classes."""
    listed, facts = report.spots, report.facts
    if facts.severity_of == "surroundings":
        return facts.class_of(spot.excess)
    off = None if listed is None else listed.off_reference(spot)
    return None if off is None else facts.class_of(off)


def _has_classes(report: Inspection) -> bool:
    assert report.spots is not None
    return bool(report.facts.severity) and (report.facts.severity_of == "surroundings" or report.spots.reference is not None)


def _class_text(report: Inspection, spot: Spot) -> str:
    found = severity(report, spot)
    return report.words("findings.below") if found is None else html.escape(found.name)


def _table(report: Inspection, listed: SpotList) -> str:
    keys = ["number", "kind", "severity", "extreme", "surroundings", "excess", "off_reference", "size", "position", "views"]
    absent = {"severity"} if not _has_classes(report) else set()
    absent |= {"off_reference"} if listed.reference is None else set()
    keys = [key for key in keys if key not in absent]
    head = "".join(f"<th>{report.words(f'column.{key}')}</th>" for key in keys)
    body = ""
    for number, spot in enumerate(listed.spots, start=1):
        cells = cells_of(report, listed, number, spot)
        # The heading of each cell stands in front of it where the screen is too narrow for columns.
        body += (
            "<tr>"
            + "".join(f'<td class="{k}" data-column="{report.words(f"column.{k}")}">{cells[k]}</td>' for k in keys)
            + "</tr>"
        )
    return f'<table class="findings"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'


def cells_of(report: Inspection, listed: SpotList, number: int, spot: Spot) -> dict[str, str]:
    """The cells of a finding, as HTML, by the catalogue's `column.KEY`."""
    words, unit = report.words, listed.unit
    error = "" if spot.std is None else f" ±\u00a0{spot.std:.2f}"
    off = listed.off_reference(spot)
    reference = "" if off is None else amount(off, unit, difference=True)
    return {
        "number": f"<b>{number}</b>",
        "kind": words(f"kind.{spot.kind}"),
        "severity": _class_text(report, spot),
        "extreme": html.escape(amount(spot.extreme, unit) + error),
        "surroundings": html.escape(amount(spot.surroundings, unit)),
        "excess": html.escape(amount(spot.excess, unit, difference=True)),
        "off_reference": html.escape(reference),
        "size": words("value.size", area=area(spot.area_m2), diameter=length(spot.diameter_m)),
        "position": position(position_of(report, spot)),
        "views": words("value.views", views=spot.views, seen=spot.seen_by),
    }


def _severity_table(report: Inspection) -> str:
    if not _has_classes(report):
        return ""
    words = report.words
    head = "".join(f"<th>{words(f'findings.{key}')}</th>" for key in ("class_head", "from_head", "action_head"))
    rows = ""
    unit = "counts" if report.run.unit == "counts" else "K"
    for entry in sorted(report.facts.severity, key=lambda c: c.from_k):
        rows += f"<tr><td>{html.escape(entry.name)}</td><td>{entry.from_k:g}\u00a0{unit}</td><td>{html.escape(entry.action)}</td></tr>"
    return f'<table class="plain"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>'


def single_section(report: Inspection) -> str:
    """A card for each finding with RGB and thermal crop; "" without findings."""
    if report.spots is None or not report.spots.spots:
        return ""
    cards = "".join(_single(report, report.spots, number, spot) for number, spot in enumerate(report.spots.spots, start=1))
    return card(report.words, "single", paragraph(report.words("single.picture")) + f'<div class="cards">{cards}</div>')


def _single(report: Inspection, listed: SpotList, number: int, spot: Spot) -> str:
    words, unit = report.words, listed.unit
    kind, excess = words.plain(f"kind.{spot.kind}"), amount(spot.excess, unit, difference=True)
    title = words("single.title", number=number, kind=kind, extreme=amount(spot.extreme, unit), excess=excess)
    cells = cells_of(report, listed, number, spot)
    facts = {words(f"column.{key}"): cells[key] for key in ("extreme", "surroundings", "size", "views")}
    if listed.reference is not None:
        facts[words("column.off_reference")] = cells["off_reference"]
    error = "" if spot.modelled_std is None else f" ±\u00a0{spot.modelled_std:.2f}"
    facts[words("single.mean")] = html.escape(amount(spot.mean, unit))
    if _has_classes(report):
        facts[words("column.severity")] = cells["severity"]
    facts[words("single.modelled")] = html.escape(amount(spot.modelled, unit) + error)
    broad = {words("single.frames"): html.escape(", ".join(spot.best_frames))}
    broad[words("single.given")] = ", ".join(minus(f"{v:.4f}") for v in spot.position_m)
    if spot.latitude_deg is not None:
        place = f"{spot.latitude_deg:.7f}, {spot.longitude_deg:.7f}, {spot.altitude_m:.2f}\u00a0m"
        broad[words("single.place")] = html.escape(place)
    rows = "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in facts.items())
    rows += "".join(f'<div class="broad"><dt>{name}</dt><dd>{value}</dd></div>' for name, value in broad.items())
    note = paragraph(words("single.differs"), "doubt") if spot.model_differs else ""
    crop = _crop(report, report.spots_folder / "spots" / f"{number:03d}.png", title)
    return f'<article id="finding-{number}"><h3>{title}</h3>{crop}<dl>{rows}</dl>{note}</article>'


def _crop(report: Inspection, path: Path, title: str) -> str:
    if not path.is_file():
        return paragraph(report.words("single.no_picture", path=path), "doubt")
    try:
        image = read_picture(path)
    except RtgsError as error:
        raise RtgsError(f"{path}: not a picture that can be read. Make it again with `rtgs spots`.") from error
    return picture(image, html.unescape(title), _PICTURE_PX)
