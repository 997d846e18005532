"""Sections: scores on held-out views, and the time that the stages took."""

from __future__ import annotations

import html
import shlex
from collections.abc import Mapping

from rtgs.base.text import first_upper
from rtgs.evaluation.records import Evaluation
from rtgs.metrics.scores import SCORES
from rtgs.run.report.pieces import missing, section, wide
from rtgs.run.report.run_records import RunRecords
from rtgs.run.report.values import duration, metric, signed_metric
from rtgs.run.stages import TITLES

_MODELS = {"rgb": "RGB", "thermal": "Thermal", "thermal_naive": "Thermal, scale ignored (s\u00a0=\u00a01)"}


def metrics_section(run: RunRecords) -> str:
    """A row a model, the difference that the scale makes, and what the scores refer to."""
    evaluation = run.evaluation
    if evaluation is None:
        return section("Metrics", missing(run, "metrics.json"))
    known = {key: scores.known() for key, scores in evaluation.models.items()}
    columns = [name for name in SCORES if any(name in values for values in known.values())]
    head = "".join(f"<th>{html.escape(SCORES[c].heading)}</th>" for c in columns)
    body = "".join(_row(_MODELS[key], [metric(c, values.get(c)) for c in columns]) for key, values in known.items())
    if "thermal_naive" in known:
        ours, naive = known["thermal"], known["thermal_naive"]
        cells = [signed_metric(c, ours[c] - naive[c] if c in ours and c in naive else None) for c in columns]
        body += _row("Change brought by the scale", cells, "total")
    table = wide(f"<thead><tr><td></td>{head}</tr></thead>{body}", "numbers")
    return section("Metrics", table + "".join(f"<p>{note}</p>" for note in _notes(run, evaluation, columns)))


def _row(title: str, cells: list[str], kind: str = "") -> str:
    name = f' class="{kind}"' if kind else ""
    return f"<tr{name}><th>{html.escape(title)}</th>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"


def _notes(run: RunRecords, evaluation: Evaluation, columns: list[str]) -> list[str]:
    count = len(evaluation.thermal.per_frame or evaluation.rgb.per_frame)
    note = "Means over held-out frames" + (f" ({count})" if count else "") + "; nothing was fitted to them."
    if run.thermal_range:
        lo, hi = run.thermal_range
        note += f" Thermal PSNR, SSIM and LPIPS are on the range {lo:.1f} to {hi:.1f} {run.unit}."
    if {"mae_c", "mae_counts"} & set(columns):
        note += " MAE: mean absolute error of the thermal values."
    if {"peak_c", "peak_counts"} & set(columns):
        note += (
            " Peak error: mean difference, and its 90th percentile, at the strongest small hot and cold spots of each photograph."
        )
    if "lpips" in columns:
        note += " LPIPS (AlexNet): how different two pictures look, 0 for equal ones."
    if run.scale is not None and run.scale.no_control:
        note += f" {html.escape(run.scale.no_control.capitalize())}"
    command = html.escape(f"rtgs eval {shlex.quote(str(run.path))}")
    return [note, *(f"{html.escape(text)} Then <code>{command}</code>." for text in evaluation.notes)]


def timings_section(run: RunRecords) -> str:
    """Seconds of each stage as bars; "" where the run has not been evaluated."""
    seconds: Mapping[str, float] = {} if run.evaluation is None else run.evaluation.timings_s
    if not seconds:
        return ""
    longest = max(seconds.values()) or 1.0
    rows = ""
    for key in [*(k for k in TITLES if k in seconds), *(k for k in seconds if k not in TITLES)]:
        bar = f'<span class="bar" style="width:{100 * seconds[key] / longest:.1f}%"></span>'
        title = html.escape(first_upper(TITLES.get(key, key)))
        rows += f"<tr><th>{title}</th><td>{duration(seconds[key])}</td><td class='bars'>{bar}</td></tr>"
    rows += f'<tr class="total"><th>All</th><td>{duration(sum(seconds.values()))}</td><td></td></tr>'
    return section("Time taken", wide(rows, "numbers timings"))
