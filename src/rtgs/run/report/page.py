"""The page: its sections in order, its frame and its style. Nothing on it is fetched: pictures and curves are inside."""

from __future__ import annotations

import html
import shlex
from pathlib import Path

from rtgs.base.errors import RtgsError
from rtgs.base.files import reason, write_text_whole
from rtgs.run.report.decisions import decisions_section
from rtgs.run.report.inputs import inputs_section, warnings_section
from rtgs.run.report.metres import metres_section
from rtgs.run.report.metrics import metrics_section, timings_section
from rtgs.run.report.run_records import RunRecords
from rtgs.run.report.scale import scale_section
from rtgs.run.report.spots import spots_section
from rtgs.run.report.verdict import page_title, verdict_header
from rtgs.run.report.views import overlay_section, rgb_section, thermal_section

_SECTIONS = (
    verdict_header,
    inputs_section,
    scale_section,
    metres_section,
    overlay_section,
    rgb_section,
    thermal_section,
    spots_section,
    metrics_section,
    decisions_section,
    timings_section,
    warnings_section,
)


def write_report(run: Path) -> Path:
    """Write `run/report.html` from what the run folder holds. What no stage has made yet is named, with the command that makes it.

    The report computes nothing: every number in it was written by a stage.

    Returns:
        The path of the report.

    Raises:
        RtgsError: no such folder, a file in it that cannot be read, or the report cannot be written.
    """
    run = Path(run)
    if not run.is_dir():
        raise RtgsError(f"{run}: no such run folder; `rtgs run CAPTURE --out {shlex.quote(str(run))}` makes one")
    records = RunRecords.read(run)
    parts = [section(records) for section in _SECTIONS]
    page = _PAGE.format(title=html.escape(page_title(records)), style=_STYLE, body="\n".join(p for p in parts if p))
    path = run / "report.html"
    try:
        write_text_whole(path, page)
    except OSError as error:
        raise RtgsError(f"{path}: cannot be written: {reason(error)}") from error
    return path


_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<style>{style}</style>
</head>
<body><main>
{body}
</main></body>
</html>
"""

_STYLE = """
:root { --ink: #1c1d21; --soft: #5d6069; --line: #e2e4e9; --card: #ffffff; --page: #f4f5f7; --accent: #2f7ed8;
  --good: #1a7f42; --fair: #9a6200; --poor: #b3261e; }
@media (prefers-color-scheme: dark) { :root { --ink: #e8e9ed; --soft: #a2a6b0; --line: #33363e; --card: #1d1f24; --page: #131418;
  --accent: #6aa9f0; --good: #5fd08a; --fair: #e8b44f; --poor: #ff8a80; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: clamp(12px, 3vw, 40px); }
header { margin: 8px 0 28px; }
h1 { font-size: clamp(1.5rem, 4vw, 2.2rem); line-height: 1.2; margin: 0 0 12px; letter-spacing: -0.01em;
  overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 0 0 14px; }
h3 { font-size: 0.9rem; font-weight: 600; color: var(--soft); margin: 18px 0 6px; overflow-wrap: anywhere; }
.verdict { font-size: clamp(1.02rem, 2.4vw, 1.2rem); max-width: 68ch; margin: 14px 0 0; }
.badge { display: inline-block; padding: 3px 12px; border-radius: 999px; font-size: 0.85rem; font-weight: 600;
  border: 1.5px solid; }
.good { color: var(--good); } .fair { color: var(--fair); } .poor { color: var(--poor); } .none { color: var(--soft); }
section { background: var(--card); border: 1px solid var(--line); border-radius: 14px; padding: clamp(14px, 2.5vw, 26px);
  margin: 0 0 18px; }
p { max-width: 75ch; margin: 0 0 12px; }
dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(150px, 1fr)); gap: 12px 20px; margin: 0 0 16px; }
dt { color: var(--soft); font-size: 0.82rem; } dd { margin: 0; overflow-wrap: anywhere; }
details { margin-top: 10px; } summary { cursor: pointer; color: var(--accent); }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.92rem; margin-top: 8px; }
th, td { text-align: left; padding: 6px 18px 6px 0; border-bottom: 1px solid var(--line); font-weight: 400;
  vertical-align: top; }
table.numbers { font-variant-numeric: tabular-nums; }
table.numbers td, thead th { text-align: right; padding-left: 10px; white-space: nowrap; }
table.timings th { white-space: nowrap; }
table.stacked th { font-weight: 600; white-space: nowrap; } table.decisions td { min-width: 7rem; }
table.decisions td:nth-child(3) { min-width: 18rem; }
table.stacked thead th { white-space: normal; text-align: left; padding-left: 0; font-weight: 400; color: var(--soft); }
table + p, .wide + p { margin-top: 14px; } section > :last-child { margin-bottom: 0; }
table.spots { font-variant-numeric: tabular-nums; }
tr.total th, tr.total td { font-weight: 600; border-bottom: 0; }
table.numbers td.bars { width: 100%; min-width: 120px; text-align: left; padding-right: 0; vertical-align: middle; }
.bar { display: block; height: 10px; min-width: 2px; border-radius: 5px; background: var(--accent); }
.pair, .triple { display: grid; gap: 10px; grid-template-columns: repeat(2, minmax(0, 1fr)); }
.triple { display: flex; margin-bottom: 8px; } .triple > * { min-width: 0; } /* shares by aspect ratio: one height a row */
.control { color: var(--soft); font-size: 0.85rem; text-align: right; margin: 0; }
figure { margin: 0; } figure img { display: block; width: 100%; height: auto; border-radius: 8px; }
figcaption { font-size: 0.82rem; color: var(--soft); margin-top: 4px; }
.chart svg { width: 100%; height: auto; display: block; } .chart svg text { font-family: inherit !important; }
.scale { max-width: 480px; margin-bottom: 12px; } .scale div { height: 12px; border-radius: 6px; }
.scale p { display: flex; justify-content: space-between; margin: 4px 0 0; font-size: 0.82rem; color: var(--soft); }
.key { display: inline-block; width: 14px; height: 14px; border-radius: 4px; vertical-align: -2px;
  border: 1px solid var(--soft); }
.cyan { background: #00d2ff; } .red { background: #ff4030; } .white { background: #ffffff; }
code { font-size: 0.88em; background: var(--page); border: 1px solid var(--line); border-radius: 5px; padding: 1px 5px;
  overflow-wrap: anywhere; }
.missing { color: var(--soft); margin: 0; }
@media (max-width: 640px) { .pair { grid-template-columns: 1fr; } .triple { gap: 5px; } .triple figcaption, .control { font-size: 0.7rem; }
  table.numbers { font-size: 0.82rem; } table.numbers :is(th, td) { padding-left: 8px; padding-right: 4px; }
  table.numbers :is(tr > :first-child) { padding-left: 0; } table.numbers thead th { white-space: normal; }
  table.numbers td.bars { display: none; } dl { gap: 8px 12px; }
  table.stacked thead { display: none; } table.stacked tr, table.stacked th, table.stacked td { display: block; }
  table.stacked tr { border-bottom: 1px solid var(--line); padding: 8px 0; }
  table.stacked tr :is(th, td) { border: 0; padding: 1px 0; min-width: 0; }
  table.stacked td::before { content: attr(data-column) ": "; color: var(--soft); } }
"""
