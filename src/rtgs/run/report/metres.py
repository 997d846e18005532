"""Section: what lengths in metres rest on."""

from __future__ import annotations

import html

from rtgs.base.text import first_upper
from rtgs.records.metres import Metres, MetresSource
from rtgs.run.report.pieces import section, wide
from rtgs.run.report.run_records import RunRecords

_TITLES = {
    "baseline": "Baseline",
    "gps": "GPS",
    "distance": "Known distance",
    "board": "Board",
    "tags": "Tags",
    "laser": "Laser range",
}


def metres_section(run: RunRecords) -> str:
    """A table of the sources, and why others give nothing; "" where the baseline is the only one that was looked for."""
    metres = run.scale.metres if run.scale else None
    if metres is None or (len(metres.sources) < 2 and not metres.absent):
        return ""
    rows = "".join(_row(source, metres) for source in metres.sources)
    if metres.sfm_per_metre is not None and metres.ci95 is not None and len(metres.sources) > 1:
        cells = f"<td>{metres.sfm_per_metre:.5g}</td><td>{metres.ci95[0]:.5g} to {metres.ci95[1]:.5g}</td><td></td>"
        rows += f'<tr class="total"><th>Together</th>{cells}</tr>'
    head = "<thead><tr><td></td><th>SfM units per metre</th><th>95 % interval</th><th>counts</th></tr></thead>"
    inside = wide(head + rows, "numbers") if rows else ""
    said = [f"<strong>{title_of(s.name)}</strong>: {html.escape(s.explanation)}." for s in metres.sources]
    said += [f"<strong>{title_of(name)}</strong> gives nothing: {html.escape(why)}." for name, why in metres.absent.items()]
    inside += "<ul>" + "".join(f"<li>{line}</li>" for line in said) + "</ul>"
    return section("What metres rest on", inside)


def source_title(name: str) -> str:
    """The name of a source for people, as text: "distance 2" is "Known distance 2"."""
    kind, _, number = name.partition(" ")
    return f"{_TITLES.get(kind, first_upper(kind))} {number}".strip()


def title_of(name: str) -> str:
    """The same, escaped."""
    return html.escape(source_title(name))


def _row(source: MetresSource, metres: Metres) -> str:
    low, high = source.ci95
    counts = "yes" if source.name in metres.rests_on else "no"
    cells = f"<td>{source.sfm_per_metre:.5g}</td><td>{low:.5g} to {high:.5g}</td><td>{counts}</td>"
    return f"<tr><th>{title_of(source.name)}</th>{cells}</tr>"
