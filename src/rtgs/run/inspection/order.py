"""Sections of fields: the order, the camera, the conditions; and what the user has to sign."""

from __future__ import annotations

import html
from dataclasses import fields as fields_of

from rtgs.run.inspection.inspection import Inspection
from rtgs.run.inspection.pieces import Row, card, fields, paragraph
from rtgs.run.report.values import size

_FROM_CAMERA = ("emissivity", "reflected_c", "distance_m")  # stated by the user, and known to radiometric files


def order_section(report: Inspection) -> str:
    """Who inspected what for whom, and when."""
    rows = [Row(f.name, getattr(report.facts.order, f.name)) for f in fields_of(report.facts.order)]
    first, last = report.rgb_tags
    taken = first.taken if first.taken == last.taken else f"{first.taken} – {last.taken}".strip(" –")
    rows = [Row("date", taken, True) if row.key == "date" and not row.value else row for row in rows]
    place = report.subject.place if report.subject else None
    if place is not None:
        rows.append(Row("place", f"{place.latitude_deg:.6f}, {place.longitude_deg:.6f}", True))
    note = ""
    if not report.facts_given:
        command = f"rtgs report {report.run.path} --template inspection --write-facts facts.json"
        note = paragraph(report.words("facts.none", command=command), "note")
    return card(report.words, "order", note + fields(report.words, rows))


def camera_section(report: Inspection) -> str:
    """The camera and its settings: what the user states, else what the files say. Where both differ, both are shown."""
    words, facts, used, tags = report.words, report.facts.camera, report.used, report.thermal_tags
    known = {"model": tags.camera, "serial": tags.serial, "lens": tags.lens}
    known |= {name: getattr(used, name) for name in _FROM_CAMERA} if used is not None else {}
    rows = []
    for field in fields_of(facts):
        stated, found = getattr(facts, field.name), known.get(field.name)
        rows.append(Row(field.name, found, True) if stated in (None, "") and found else Row(field.name, stated))
    if used is not None:
        rows.append(Row("atmospheric_c", used.atmospheric_c, True))
        rows.append(Row("relative_humidity", f"{100 * used.relative_humidity:.0f} %", True))
    rgb = report.rgb_tags[0]
    rows += [Row(key, value, True) for key, value in (("rgb_camera", rgb.camera), ("rgb_serial", rgb.serial)) if value]
    if report.run.summary is not None:
        rows.append(Row("thermal_size", size(report.run.summary.thermal_size), True))
    return card(words, "camera", fields(words, rows) + "".join(paragraph(t, "doubt") for t in differing(report)))


def differing(report: Inspection) -> list[str]:
    """Sentences on settings that the user states otherwise than temperatures were computed with."""
    used, words, found = report.used, report.words, []
    for name in _FROM_CAMERA if used is not None else ():
        stated, value = getattr(report.facts.camera, name), getattr(used, name)
        if stated is not None and abs(stated - value) > 1e-6 * max(abs(value), 1.0):
            title = words.plain(f"field.{name}")
            found.append(words("facts.differ", field=title, stated=f"{stated:g}", used=f"{value:g}"))
    return found


def weather_section(report: Inspection) -> str:
    """The conditions, as the user states them."""
    weather = report.facts.weather
    return card(
        report.words, "weather", fields(report.words, [Row(f.name, getattr(weather, f.name)) for f in fields_of(weather)])
    )


def remarks_section(report: Inspection) -> str:
    """What the user adds; "" where there is nothing."""
    text = html.escape(report.facts.remarks).replace("\n", "<br>")
    return card(report.words, "remarks", paragraph(text)) if text else ""


def signature_section(report: Inspection) -> str:
    """Lines to sign on paper."""
    keys = ("signature_name", "signature_date", "signature")
    lines = "".join(f'<div><span class="line"></span>{report.words(f"field.{key}")}</div>' for key in keys)
    return card(report.words, "signature", f'<div class="sign">{lines}</div>', "whole")


def made_section(report: Inspection) -> str:
    """Capture, program and files."""
    run, rows = report.run, []
    rows.append(Row("capture", str(run.capture) if run.capture else None))
    if run.summary is not None:
        frames = report.words.plain("field.frames_value", registered=run.summary.registered, frames=run.summary.frames)
        rows.append(Row("frames", frames))
    rows.append(Row("version", f"rtgs {run.version}" if run.version else None))
    rows.append(Row("spots", str(report.spots_folder / "spots.json") if report.spots is not None else None))
    return card(report.words, "made", fields(report.words, rows))
