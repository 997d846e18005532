"""Section: what the stages decided by themselves, with the errors and thresholds behind each decision."""

from __future__ import annotations

import html
import math

from rtgs.records.decision import Decision
from rtgs.run.report.pieces import section
from rtgs.run.report.run_records import RunRecords
from rtgs.run.report.values import minus

_TITLES = {
    "background": "Background of the imported RGB model",
    "rows": "Rows of the photographs",
    "drift": "Drift of the sensor",
    "pattern": "Pattern of the sensor",
    "gains": "Gain of each frame",
    "ridge": "Regularisation (ridge)",
    "geometry": "Geometry of the thermal model",
}
_COLUMNS = ("Decided about", "Chosen", "Because", "Mean error before → after", "Improvement needed")


def decisions_section(run: RunRecords) -> str:
    """A table of the decisions in `rgb.json` and `thermal.json`; "" where none are recorded."""
    if not run.decisions:
        return ""
    head = "".join(f"<th>{column}</th>" for column in _COLUMNS)
    rows = "".join(_row(decision) for decision in run.decisions)
    note = (
        "<p>A run makes these choices by itself, unless a setting makes them. The thermal fit fits some of the training frames with "
        "and without what is decided about, and compares the mean error on the other ones, the validation frames. The background of "
        "an imported RGB model is fitted to training photographs. Held-out frames are not used.</p>"
    )
    table = f'<table class="decisions stacked"><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>'
    return section("Decisions", f'{note}<div class="wide">{table}</div>')


def _row(decision: Decision) -> str:
    needed = "–" if decision.threshold is None else f"{100 * decision.threshold:.3g}\u00a0%"
    cells = [html.escape(c) for c in (decision.choice, decision.reason, _errors(decision), needed)]
    # The heading of each cell stands in front of it where the screen is too narrow for columns.
    body = "".join(f'<td data-column="{name}">{cell}</td>' for name, cell in zip(_COLUMNS[1:], cells, strict=True))
    return f"<tr><th>{html.escape(_TITLES.get(decision.name, decision.name))}</th>{body}</tr>"


def _errors(decision: Decision) -> str:
    """ "0.412 → 0.395 °C (−4.1 %)"; one number where only one was measured."""
    unit = f"\u00a0{decision.unit}" if decision.unit else ""
    measured = [error for error in (decision.error_before, decision.error_after) if error is not None]
    if not measured:
        return "not measured"
    decimals = _decimals(max(measured))
    change = ""
    if len(measured) == 2 and measured[0] > 0:
        change = minus(f" ({100 * (measured[1] / measured[0] - 1):+.1f}\u00a0%)")
    return " → ".join(f"{error:.{decimals}f}" for error in measured) + unit + change


def _decimals(number: float) -> int:
    """How many decimals show three digits of a positive number."""
    return max(0, 2 - math.floor(math.log10(number))) if number > 0 else 2
