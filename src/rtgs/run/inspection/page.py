"""The page: its sections in order and its frame. Nothing on it is fetched: pictures, drawings and style are inside."""

from __future__ import annotations

import html
import shlex
from importlib.resources import files
from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.files import reason, write_text_whole
from rtgs.base.progress import Progress
from rtgs.run.inspection.facts import InspectionFacts
from rtgs.run.inspection.findings import findings_section, single_section
from rtgs.run.inspection.inspection import Inspection
from rtgs.run.inspection.marks import marks_section
from rtgs.run.inspection.metres import accuracy_section, scale_section, warnings_section
from rtgs.run.inspection.order import (
    camera_section,
    made_section,
    order_section,
    remarks_section,
    signature_section,
    weather_section,
)
from rtgs.run.inspection.plan import plan_section
from rtgs.run.inspection.words import Words

_SECTIONS = (
    order_section,
    camera_section,
    weather_section,
    findings_section,
    marks_section,
    single_section,
    plan_section,
    scale_section,
    accuracy_section,
    warnings_section,
    remarks_section,
    made_section,
    signature_section,
)


def write_inspection(
    run: Path, out: Path, *, facts: InspectionFacts | None = None, spots: Path | None = None, progress: Progress | None = None
) -> Path:
    """Write an inspection report as one HTML file that prints well. What is missing is named, with the command that makes it.

    Numbers are those of the run's records and of the list of spots; only pictures are rendered.

    Args:
        facts: what the user states; None: all of it is shown as not stated.
        spots: the folder that `rtgs spots` wrote; None: `run/spots`.
        progress: called with (sections done, sections in all, name).

    Returns:
        `out`.

    Raises:
        RtgsError: no such run, a run without metres, a named folder without a list, a record or picture that is damaged, or the report
            cannot be written.
    """
    if not run.is_dir():
        raise RtgsError(f"{run}: no such run folder; `rtgs run CAPTURE --out {shlex.quote(str(run))}` makes one")
    if spots is not None and not (spots / "spots.json").is_file():
        raise RtgsError(f"--spots {spots}: has no spots.json; `rtgs spots {shlex.quote(str(run))} --out {spots}` makes it.")
    if out.suffix.lower() not in (".html", ".htm") or out.is_dir():
        raise RtgsError(f"--out {out}: name a file that ends in .html.")
    words = Words.load()
    report = Inspection.read(run, facts, run / "spots" if spots is None else spots, words)
    if report.run.scale is not None and report.run.scale.no_metres:
        raise RtgsError(f"{run}: an inspection report states lengths in metres, and {report.run.scale.no_metres}")
    parts = []
    for done, section in enumerate(_SECTIONS):
        if progress is not None:
            progress(done, len(_SECTIONS), section.__name__.removesuffix("_section"))
        parts.append(section(report))
    body = "\n".join(part for part in parts if part)
    site = report.facts.order.site or report.facts.order.object or report.run.name
    title = words("title.of", site=site)
    head = (
        f'<header><p class="over">{words("title")}</p><h1>{html.escape(site)}</h1><p class="screen">{words("print")}</p></header>'
    )
    style = (files("rtgs.run.inspection") / "page.css").read_text(encoding="utf-8")
    page = _PAGE.format(language=words("language"), title=title, style=style, head=head, body=body)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_text_whole(out, page)
    except OSError as error:
        raise RtgsError(f"{out}: cannot be written: {reason(error)}") from error
    return out


_PAGE = """<!doctype html>
<html lang="{language}">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>{title}</title>
<style>{style}</style>
</head>
<body><main>
{head}
{body}
</main></body>
</html>
"""
