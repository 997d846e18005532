"""Sections: edge overlays, and held-out views beside their photographs."""

from __future__ import annotations

import html

import matplotlib
import numpy as np

from rtgs.metrics.scores import SCORES
from rtgs.run.report.pieces import figure, frame_names, missing, picture, read_picture, section
from rtgs.run.report.run_records import RunRecords

MOST_OVERLAYS = 3


def overlay_section(run: RunRecords) -> str:
    """Edges of the RGB model on those of the thermal images, before and after."""
    names = frame_names(run, "overlay", "after", MOST_OVERLAYS)
    if not names:
        return section("Do the edges meet?", missing(run, "edge overlays"))
    legend = (
        "<p>The RGB model seen from the thermal camera. <b class='key cyan'></b> edges of that render, "
        "<b class='key red'></b> edges of the thermal image, <b class='key white'></b> where the two meet.</p>"
    )
    captions = {"before": "before: scale ignored (1 SfM unit = 1 m)", "after": "after: scale as found"}
    if run.scale is not None and run.scale.calibration is not None:
        captions = {"before": "before: where the search for the rig began", "after": "after: rig as found"}
    rows = []
    for name in names:
        figures = [figure(picture(run, "overlay", name, what), caption, sharp=True) for what, caption in captions.items()]
        rows.append(f'<h3>{html.escape(name)}</h3><div class="pair">{"".join(figures)}</div>')
    return section("Do the edges meet?", legend + "".join(rows))


def rgb_section(run: RunRecords) -> str:
    """Photograph, render and error of held-out RGB views."""
    names = frame_names(run, "rgb", "render")
    if not names:
        return section("Held-out RGB views", missing(run, "RGB renders"))
    return section("Held-out RGB views", "".join(_heading(name) + _triple(run, "rgb", name) for name in names))


def thermal_section(run: RunRecords) -> str:
    """The same of thermal views, each with its control below."""
    names = frame_names(run, "thermal", "render")
    if not names:
        return section("Held-out thermal views", missing(run, "thermal renders"))
    rows = [_heading(name) + _triple(run, "thermal", name) + _control(run, name) for name in names]
    return section("Held-out thermal views", _colour_bar(run) + "".join(rows))


def _heading(name: str) -> str:
    return f"<h3>{html.escape(name)}</h3>"


def _triple(run: RunRecords, model: str, name: str) -> str:
    captions = {"reference": "reference", "render": "render" + _scores(run, model, name), "error": "error"}
    figures = [figure(picture(run, model, name, what), caption) for what, caption in captions.items()]
    return f'<div class="triple">{"".join(figures)}</div>'


def _control(run: RunRecords, name: str) -> str:
    captions = {"render": "scale ignored" + _scores(run, "thermal_naive", name), "error": "its error"}
    figures = [figure(picture(run, "thermal_naive", name, what), caption) for what, caption in captions.items()]
    if not any(figures):
        return ""
    # The words fill the reference's place, which keeps each control under the picture that it is the control of.
    image = read_picture(picture(run, "thermal", name, "render"))
    aspect = image.width / image.height
    words = "Control: the same thermal fit with the scale ignored, s = 1."
    figures.insert(0, f'<p class="control" style="flex:{aspect:.4f} 1 0">{words}</p>')
    return f'<div class="triple">{"".join(figures)}</div>'


def _scores(run: RunRecords, model: str, name: str) -> str:
    """For a caption: " · 31.20 dB · 0.61 °C", with spaces that do not break a line within a number."""
    models = {} if run.evaluation is None else run.evaluation.models
    if model not in models or name not in models[model].per_frame:
        return ""
    known = models[model].per_frame[name].known()
    return "".join(f" · {SCORES[m].text(known[m])}".replace(" ", "\u00a0") for m in ("psnr", "mae_c") if m in known)


def _colour_bar(run: RunRecords) -> str:
    if run.thermal_range is None:
        return ""
    colours = matplotlib.colormaps["inferno"](np.linspace(0, 1, 12))[:, :3]
    stops = ", ".join(matplotlib.colors.to_hex(c) for c in colours)
    unit = " °C" if run.unit == "°C" else ""
    ticks = "".join(f"<span>{t:.1f}{unit}</span>" for t in np.linspace(*run.thermal_range, 5))
    return f'<div class="scale"><div style="background:linear-gradient(to right, {stops})"></div><p>{ticks}</p></div>'
