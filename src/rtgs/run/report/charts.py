"""Curves of the scale as SVG inside the page."""

from __future__ import annotations

import html
import io
import re

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from rtgs.scale import ScaleEstimate

INK = "#010203"  # a colour nobody draws with: it becomes currentColor, so that curves follow the page's light or dark scheme
_TEXT_PT, _SMALL_PT = 11, 10  # a chart is drawn at two thirds of its size on a telephone
_CURVE, _CHOSEN = "#2f7ed8", "#e4572e"


def scan_chart(scale: ScaleEstimate) -> str:
    """Loss over the whole bracket; "" where no scan was made."""
    if scale.scan is None or len(scale.scan.loss) < 2:
        return ""
    x, loss, error = (np.array(v) for v in (scale.scan.sfm_per_metre, scale.scan.loss, scale.scan.std_error))
    figure, axes = _axes("SfM units per metre", "loss")
    axes.fill_between(x, loss - error, loss + error, color=_CURVE, alpha=0.25, linewidth=0, label="± 1 s.e. over frames")
    axes.plot(x, loss, color=_CURVE, linewidth=1.6, marker="o" if len(x) < 60 else "", markersize=2.5, label="mean over frames")
    _mark_interval(axes, scale)
    axes.axvline(scale.sfm_per_metre, color=_CHOSEN, linewidth=1.4, label=f"chosen: {scale.sfm_per_metre:.4g}")
    for minimum in scale.minima:
        s = minimum.sfm_per_metre
        axes.axvline(s, color=_CHOSEN, linewidth=1.2, linestyle=":", label=f"other minimum: {s:.4g}")
    _log_axis(axes, "x", float(x.min()), float(x.max()))
    _legend(axes)
    return as_svg(figure, "Loss over the scale: the scan")


def local_chart(scale: ScaleEstimate) -> str:
    """Loss above its minimum close to the answer: the mean, and each frame's; "" where it was not computed."""
    x, loss = (np.array(v) for v in (scale.local.sfm_per_metre, scale.local.loss))
    if len(x) < 2:
        return ""
    lowest = int(np.argmin(loss))
    figure, axes = _axes("SfM units per metre", "loss above that of the answer")
    for k, curve in enumerate(map(np.array, scale.local.per_frame.values())):
        label = "single frames" if k == 0 else None
        axes.plot(x, curve - curve[lowest], color=INK, alpha=0.18, linewidth=0.7, label=label)
    axes.plot(x, loss - loss[lowest], color=_CURVE, linewidth=1.6, marker="o", markersize=2.5, label="mean over frames")
    _mark_interval(axes, scale)
    axes.axvline(scale.sfm_per_metre, color=_CHOSEN, linewidth=1.4)
    rise = float(np.max(loss - loss[lowest]))
    if rise > 0:
        axes.set_ylim(-rise, 2 * rise)  # the mean decides; steeper frames may leave the picture
    _legend(axes)
    return as_svg(figure, "Loss close to the answer: what the interval is taken from")


def history_chart(scale: ScaleEstimate, solver: str) -> str:
    """Scale and loss over the solver's steps; "" where there are none. solver: its name in words."""
    step, value, loss = (np.array(v) for v in (scale.history.step, scale.history.sfm_per_metre, scale.history.loss))
    if len(step) < 2:
        return ""
    figure, axes = _axes("step", "SfM units per metre")
    axes.plot(step, value, color=_CHOSEN, linewidth=1.6, marker="o" if len(step) < 25 else "", markersize=3)
    _log_axis(axes, "y", float(value.min()), float(value.max()))
    axes.yaxis.label.set_color(_CHOSEN)
    right = axes.twinx()
    right.plot(step, loss, color=_CURVE, linewidth=1.2)
    plain_axes(right)
    right.spines["right"].set_visible(True)
    right.set_ylabel("loss", color=_CURVE, fontsize=_TEXT_PT)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    return as_svg(figure, f"Refinement by {solver}")


def _mark_interval(axes: Axes, scale: ScaleEstimate) -> None:
    if scale.ci95 and scale.ci95[0] > 0:
        axes.axvspan(*scale.ci95, color=_CHOSEN, alpha=0.18, linewidth=0, label="95 % interval")


def _legend(axes: Axes) -> None:
    """Above the curves, which it would hide from within."""
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=2,
        borderaxespad=0.2,
        frameon=False,
        fontsize=_SMALL_PT,
        labelcolor=INK,
    )


def _axes(x: str, y: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(5.4, 3.8), layout="constrained")
    axes = figure.subplots()
    plain_axes(axes)
    axes.set_xlabel(x, color=INK, fontsize=_TEXT_PT)
    axes.set_ylabel(y, color=INK, fontsize=_TEXT_PT)
    axes.grid(True, color=INK, alpha=0.12, linewidth=0.6)
    return figure, axes


def plain_axes(axes: Axes) -> None:
    axes.tick_params(colors=INK, which="both", labelsize=_SMALL_PT)
    for side, spine in axes.spines.items():
        spine.set_color(INK)
        spine.set_visible(side in ("left", "bottom"))
    axes.patch.set_alpha(0)


def _log_axis(axes: Axes, which: str, lo: float, hi: float) -> None:
    if not 0 < lo < hi:
        return
    getattr(axes, f"set_{which}scale")("log")
    axis = axes.xaxis if which == "x" else axes.yaxis
    # Under half a decade, 1-2-5 ticks would leave one label or none.
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)) if hi / lo > 4 else MaxNLocator(5))
    axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())


def as_svg(figure: Figure, caption: str) -> str:
    buffer = io.StringIO()
    # Text stays text (small, and in the page's own font); the salt makes ids the same on every run and different between charts.
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": caption, "font.family": "sans-serif"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    svg = buffer.getvalue()
    svg = re.sub(r'<g id="[^"]*">', "<g>", svg[svg.index("<svg") :])  # group names, alike in every chart; nothing refers to them
    svg = svg.replace(INK, "currentColor")
    return f"<figure class='chart'>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>"
