"""Figures of the synthetic experiment: error against the start, and how many trials stay below an error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rtgs.base.files import write_whole
from rtgs.experiments.records import Record

_LEAST_PCT = 1e-3  # smaller errors are drawn here


def draw_errors(folder: Path, records: Sequence[Record], titles: Mapping[str, str]) -> list[Path]:
    """Draw two SVG files from the records of Table I.

    Args:
        titles: method → its name in the legend, in the legend's order.

    Returns:
        The paths.
    """
    figures = {"errors_by_start": _by_start, "errors_cumulative": _cumulative}
    written = []
    for name, draw in figures.items():
        path = folder / f"{name}.svg"
        with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name, "font.family": "sans-serif"}):
            figure = Figure(figsize=(7.0, 4.0), layout="constrained")
            axes = figure.subplots()
            for k, (method, title) in enumerate(titles.items()):
                found = [r for r in records if r.method == method]
                if found:
                    draw(axes, found, title, f"C{k}")
            axes.legend(fontsize="small")
            axes.grid(alpha=0.3)
            with write_whole(path) as part:
                figure.savefig(part, format="svg", metadata={"Date": None})
        written.append(path)
    return written


def _by_start(axes: Axes, records: Sequence[Record], title: str, colour: str) -> None:
    starts = [r.start / r.truth for r in records]
    axes.scatter(starts, [max(r.error_pct, _LEAST_PCT) for r in records], s=14, color=colour, label=title, alpha=0.8)
    axes.set(xlabel="start / truth", ylabel="error of the scale, %", xscale="log", yscale="log")
    axes.set_xticks([0.5, 0.7, 1.0, 1.4, 2.0], ["0.5", "0.7", "1", "1.4", "2"])
    axes.minorticks_off()


def _cumulative(axes: Axes, records: Sequence[Record], title: str, colour: str) -> None:
    errors = np.sort([max(r.error_pct, _LEAST_PCT) for r in records])
    axes.step(errors, 100 * np.arange(1, len(errors) + 1) / len(errors), where="post", color=colour, label=title)
    axes.set(xlabel="error of the scale, %", ylabel="trials below, %", xscale="log", ylim=(0, 102))
