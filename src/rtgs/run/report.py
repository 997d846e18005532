"""One HTML file that tells a person how a run went. No part of it is fetched from anywhere: pictures and curves are inside.

It reads the run folder only, takes every part of it as optional, and computes nothing that the stages have not already written.
"""

from __future__ import annotations

import base64
import html
import io
import json
import math
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator
from PIL import Image

from rtgs.base.errors import RtgsError
from rtgs.base.files import write_text_whole

MOST_FRAMES = 6
MOST_OVERLAYS = 3
PICTURE_WIDTH_PX = 560
_SVG_INK = "#010203"  # a colour nobody draws with: it becomes currentColor, so that curves follow the page's light or dark scheme
_CURVE, _CHOSEN = "#2f7ed8", "#e4572e"

_METRICS = {"psnr": "PSNR, dB", "ssim": "SSIM", "lpips": "LPIPS", "mae_c": "Mean error, °C"}
_DECIMALS = {"psnr": 2, "ssim": 3, "lpips": 3, "mae_c": 2}
_MODELS = {"rgb": "RGB", "thermal": "Thermal", "thermal_naive": "Thermal, scale ignored (s = 1)"}
_STAGES = {
    "sfm": "Structure from motion",
    "rgb": "RGB model",
    "scale": "Scale",
    "thermal": "Thermal model",
    "thermal_naive": "Thermal control (s = 1)",
    "evaluate": "Evaluation",
}
_STATUS = {
    "ok": ("good", "Scale found"),
    "ambiguous": ("fair", "Scale ambiguous"),
    "unobservable": ("poor", "Scale cannot be observed"),
}


def write_report(run: Path) -> Path:
    """Write `run/report.html` from what the run folder holds; what no stage has made yet is named with the command that makes it.

    Returns:
        The path of the report.

    Raises:
        RtgsError: no such folder, a JSON file in it that cannot be read, or the report cannot be written.
    """
    run = Path(run)
    if not run.is_dir():
        raise RtgsError(f"{run}: no such run folder; `rtgs run CAPTURE --out {shlex.quote(str(run))}` makes one")
    contents = _Run(run, *(_json(run / f"{name}.json") for name in ("config", "capture_summary", "scale", "metrics")))
    parts = [_verdict(contents), _what_was_run(contents), _scale(contents), _overlays(contents), _rgb(contents)]
    parts += [_thermal(contents), _metrics(contents), _timings(contents), _warnings(contents)]
    title = f"RGB–thermal model of {contents.name}"
    page = _PAGE.format(title=html.escape(title), style=_STYLE, body="\n".join(p for p in parts if p))
    path = run / "report.html"
    try:
        write_text_whole(path, page)
    except OSError as error:
        raise RtgsError(f"{path}: cannot be written ({error.strerror or error})") from error
    return path


@dataclass(frozen=True)
class _Run:
    """A run folder's JSON files; each is empty where the file is absent."""

    path: Path
    config: Mapping[str, Any]
    capture: Mapping[str, Any]
    scale: Mapping[str, Any]
    metrics: Mapping[str, Any]

    @property
    def name(self) -> str:
        return Path(str(self.config.get("capture", ""))).name or self.path.resolve().name

    @property
    def command(self) -> str:
        """Resumes the run: stages that are done are not repeated."""
        return f"rtgs run {shlex.quote(str(self.config.get('capture', 'CAPTURE')))} --out {shlex.quote(str(self.path))}"

    @property
    def unit(self) -> str:
        return "" if self.capture.get("thermal_unit") == "relative" else "°C"

    @cached_property
    def range_c(self) -> tuple[float, float] | None:
        return _pair(self.metrics.get("temperature_range_c"))

    def names(self, folder: str, suffix: str, at_most: int = MOST_FRAMES) -> list[str]:
        """Frames that have `renders/folder/NAME.suffix.png`, evenly chosen in name order."""
        end = f".{suffix}.png"
        found = sorted(p.name.removesuffix(end) for p in (self.path / "renders" / folder).glob(f"*{end}") if p.name != end)
        return [found[i] for i in _evenly(len(found), at_most)]

    def picture(self, folder: str, name: str, what: str) -> Path:
        return self.path / "renders" / folder / f"{name}.{what}.png"


# --- sections, in the page's order ---


def _verdict(run: _Run) -> str:
    said = []
    badge = ""
    sfm_per_metre = _number(run.scale.get("sfm_per_metre"))
    baseline_m = _number(run.scale.get("baseline_m")) or _number(run.capture.get("baseline_m"))
    if sfm_per_metre is None:
        badge = '<span class="badge none">Scale not estimated yet</span>'
        said.append("This run has no scale so far.")
    else:
        colour, words = _STATUS.get(str(run.scale.get("status")), ("none", f"Scale: {run.scale.get('status')}"))
        badge = f'<span class="badge {colour}">{html.escape(words)}</span>'
        sentence = f"One metre is <strong>{sfm_per_metre:.4g} SfM units</strong>"
        interval = _pair(run.scale.get("ci95"))
        if interval:
            sentence += f" (95 % interval {interval[0]:.4g} to {interval[1]:.4g})"
        if baseline_m:
            sentence += f"; the rig's baseline of {_length(baseline_m)} spans {baseline_m * sfm_per_metre:.3g} of them"
        said.append(sentence + ".")
        reason = str(run.scale.get("reason") or "").rstrip(".")
        if run.scale.get("status") != "ok":
            said.append("Do not rely on this number" + (f": {html.escape(reason)}." if reason else "."))
    thermal, naive = (_number(_get(run.metrics, model, "psnr")) for model in ("thermal", "thermal_naive"))
    if thermal is not None:
        sentence = f"On views it never saw, the thermal model reaches <strong>{thermal:.1f}\u00a0dB</strong>"
        if naive is not None:
            gain = thermal - naive
            if abs(gain) < 0.05:
                sentence += ", neither better nor worse than with the scale ignored (s = 1)"
            else:
                sentence += (
                    f", <strong>{abs(gain):.1f}\u00a0dB {'better' if gain > 0 else 'worse'}</strong> than with the scale ignored"
                )
        mae = _number(_get(run.metrics, "thermal", "mae_c"))
        if mae is not None and run.unit:
            sentence += f"; its temperatures are off by <strong>{mae:.2f}\u00a0°C</strong> on average"
        said.append(sentence + ".")
        if not run.unit:
            said.append("The capture has no radiometric calibration, so thermal values are relative, not degrees.")
    title = html.escape(f"RGB–thermal model of {run.name}")
    return f'<header><h1>{title}</h1>{badge}<p class="verdict">{" ".join(said)}</p></header>'


def _what_was_run(run: _Run) -> str:
    frames, registered = run.capture.get("frames"), run.capture.get("registered")
    facts = {
        "Capture": run.config.get("capture"),
        "Frames": frames if frames is None or registered is None else f"{frames}, of which {registered} registered",
        "RGB image": _size(run.capture.get("rgb_size")),
        "Thermal image": _size(run.capture.get("thermal_size")),
        "Thermal unit": {"celsius": "°C", "relative": "relative counts"}.get(str(run.capture.get("thermal_unit"))),
        "Baseline": None if not _number(run.capture.get("baseline_m")) else _length(float(run.capture["baseline_m"])),
        "rtgs": run.config.get("version"),
    }
    settings = list(_flattened(run.config.get("settings") or {}))
    table = ""
    if settings:
        cells = "".join(f"<tr><td><code>{html.escape(k)}</code></td><td>{html.escape(v)}</td></tr>" for k, v in settings)
        table = (
            f'<details><summary>All {len(settings)} settings</summary><div class="wide"><table>{cells}</table></div></details>'
        )
    missing = (
        ""
        if run.config and run.capture
        else _missing(
            run, " and ".join(n for n, v in (("config.json", run.config), ("capture_summary.json", run.capture)) if not v)
        )
    )
    return _section("What was run", _facts(facts) + table + missing)


def _scale(run: _Run) -> str:
    if not run.scale:
        return _section("Scale", _missing(run, "scale.json"))
    scale = run.scale
    sfm_per_metre = _number(scale.get("sfm_per_metre"))
    std_log, bracket, interval = _number(scale.get("std_log")), _pair(scale.get("bracket")), _pair(scale.get("ci95"))
    facts = {
        "SfM units per metre": None if sfm_per_metre is None else f"{sfm_per_metre:.5g}",
        "Metres per SfM unit": None if not sfm_per_metre else f"{1 / sfm_per_metre:.5g}",
        "Standard error": None if std_log is None else f"{100 * std_log:.2g} %",
        "95 % interval": None if interval is None else f"{interval[0]:.5g} to {interval[1]:.5g}",
        "Searched": None if bracket is None else f"{bracket[0]:.3g} to {bracket[1]:.3g}",
        "Solver": _solver(scale),
        "Started at": f"{scale['init']:.4g}" if _number(scale.get("init")) is not None else scale.get("init"),
        "Frames used": len(scale["frames"]) if isinstance(scale.get("frames"), list) else None,
        "Other minima": ", ".join(f"{s:.4g} (better in {100 * c:.2g} % of resamples)" for s, c in _minima(scale)) or None,
        "Blur of the thermal lens": f"{blur:.2g} px" if (blur := _number(scale.get("blur_px"))) else None,
        "Frames that disagree": ", ".join(map(str, scale.get("disagreeing") or [])) or None,
    }
    reason = scale.get("reason")
    note = f"<p>{html.escape(str(reason))}</p>" if reason else ""
    second = _local_chart(scale) if scale.get("solver") == "global" else _history_chart(scale)
    charts = [c for c in (_scan_chart(scale), second) if c]
    pair = f'<div class="pair">{"".join(charts)}</div>' if charts else ""
    return _section("Scale", _facts(facts) + note + pair + _refinement(scale.get("refinement") or {}))


def _refinement(refinement: Mapping[str, Any]) -> str:
    """What of the calibration was refined with the scale."""
    freedoms = refinement.get("freedoms") or []
    if not freedoms:
        return ""
    rows = ""
    for f in freedoms:
        mean, std, prior = (_number(f.get(k)) for k in ("mean", "std", "prior_std"))
        unit = html.escape(str(f.get("unit", "")))
        found = "–" if mean is None or std is None else f"{mean:+.3f} ± {std:.3f} {unit}".replace("-", "−")
        expected = "–" if prior is None else f"0 ± {prior:.3g} {unit}"
        known = "yes" if f.get("decided") else "no, as calibrated"
        rows += f"<tr><th>{html.escape(str(f.get('name')))}</th><td>{expected}</td><td>{found}</td><td>{known}</td></tr>"
    head = "<tr><td></td><th>calibration</th><th>found</th><th>decided by the images</th></tr>"
    before = _number(refinement.get("before"))
    note = "" if before is None else f" Without this the scale would be {before:.5g} SfM units per metre."
    return (
        "<p>The calibration was refined with the scale; every later stage uses the refined rig, and rig.json is as it was. Standard "
        f'deviations stand behind ±.{note}</p><div class="wide"><table class="numbers"><thead>{head}</thead>{rows}</table></div>'
    )


def _overlays(run: _Run) -> str:
    names = run.names("overlay", "after", MOST_OVERLAYS)
    legend = (
        "<p>The RGB model seen from the thermal camera. <b class='key cyan'></b> edges of that render, "
        "<b class='key red'></b> edges of the thermal image, <b class='key white'></b> where the two meet.</p>"
    )
    if not names:
        return _section("Do the edges meet?", _missing(run, "edge overlays"))
    rows = []
    for name in names:
        figures = [
            _figure(run.picture("overlay", name, what), caption, sharp=True)
            for what, caption in (("before", "before: scale ignored (1 SfM unit = 1 m)"), ("after", "after: scale as found"))
        ]
        rows.append(f'<h3>{html.escape(name)}</h3><div class="pair">{"".join(figures)}</div>')
    return _section("Do the edges meet?", legend + "".join(rows))


def _rgb(run: _Run) -> str:
    names = run.names("rgb", "render")
    if not names:
        return _section("Held-out RGB views", _missing(run, "RGB renders"))
    rows = []
    for name in names:
        scores = _scores(run, "rgb", name)
        figures = [
            _figure(run.picture("rgb", name, "reference"), "reference"),
            _figure(run.picture("rgb", name, "render"), "render" + scores),
            _figure(run.picture("rgb", name, "error"), "error"),
        ]
        rows.append(f'<h3>{html.escape(name)}</h3><div class="triple">{"".join(figures)}</div>')
    return _section("Held-out RGB views", "".join(rows))


def _thermal(run: _Run) -> str:
    names = run.names("thermal", "render")
    if not names:
        return _section("Held-out thermal views", _missing(run, "thermal renders"))
    rows = []
    for name in names:
        figures = [
            _figure(run.picture("thermal", name, "reference"), "reference"),
            _figure(run.picture("thermal", name, "render"), "render" + _scores(run, "thermal", name)),
            _figure(run.picture("thermal", name, "error"), "error"),
        ]
        naive = [
            _figure(run.picture("thermal_naive", name, "render"), "scale ignored" + _scores(run, "thermal_naive", name)),
            _figure(run.picture("thermal_naive", name, "error"), "its error"),
        ]
        if any(naive):
            # The words fill the reference's place, which keeps each control under the picture that it is the control of.
            with Image.open(run.picture("thermal", name, "render")) as image:
                aspect = image.width / image.height
            words = "Control: the same thermal fit with the scale ignored, s = 1."
            naive.insert(0, f'<p class="control" style="flex:{aspect:.4f} 1 0">{words}</p>')
        rows.append(f'<h3>{html.escape(name)}</h3><div class="triple">{"".join(figures)}</div>')
        rows.append(f'<div class="triple">{"".join(naive)}</div>' if any(naive) else "")
    return _section("Held-out thermal views", _colour_bar(run) + "".join(rows))


def _metrics(run: _Run) -> str:
    present = {key: run.metrics[key] for key in _MODELS if isinstance(run.metrics.get(key), dict)}
    if not present:
        return _section("Metrics", _missing(run, "metrics.json"))
    known = [m for m in _METRICS if any(_number(v.get(m)) is not None for v in present.values())]
    others = sorted({k for v in present.values() for k in v if k not in _METRICS and _number(v[k]) is not None})
    columns: list[str] = [*known, *others]
    head = "".join(f"<th>{html.escape(_METRICS.get(c, c))}</th>" for c in columns)
    body = ""
    for key, values in present.items():
        cells = "".join(f"<td>{_metric(c, values.get(c))}</td>" for c in columns)
        body += f"<tr><th>{html.escape(_MODELS[key])}</th>{cells}</tr>"
    if "thermal" in present and "thermal_naive" in present:
        cells = ""
        for c in columns:
            ours, naive = _number(present["thermal"].get(c)), _number(present["thermal_naive"].get(c))
            cells += f"<td>{'–' if ours is None or naive is None else _signed(c, ours - naive)}</td>"
        body += f'<tr class="total"><th>Change brought by the scale</th>{cells}</tr>'
    count = len(_get(run.metrics, "thermal", "per_frame") or _get(run.metrics, "rgb", "per_frame") or {})
    note = "<p>Means over held-out frames" + (f" ({count})" if count else "") + "; nothing was fitted to them."
    if run.range_c:
        lo, hi = run.range_c
        note += f" Thermal PSNR, SSIM and LPIPS are on the range {lo:.1f} to {hi:.1f} {run.unit or 'counts'}."
    if "lpips" in known:
        note += " LPIPS (AlexNet): how different two pictures look, 0 for equal ones."
    for text in run.metrics.get("notes") or []:
        note += f"</p><p>{html.escape(str(text))} Then <code>{html.escape(f'rtgs eval {shlex.quote(str(run.path))}')}</code>."
    return _section(
        "Metrics",
        f'<div class="wide"><table class="numbers"><thead><tr><td></td>{head}</tr></thead>{body}</table></div>{note}</p>',
    )


def _timings(run: _Run) -> str:
    timings = {k: _number(v) for k, v in (run.metrics.get("timings_s") or {}).items()}
    known = {k: v for k, v in timings.items() if v is not None}
    if not known:
        return ""
    longest, total = max(known.values()) or 1.0, sum(known.values())
    rows = ""
    for key in [*(k for k in _STAGES if k in known), *(k for k in known if k not in _STAGES)]:
        bar = f'<span class="bar" style="width:{100 * known[key] / longest:.1f}%"></span>'
        rows += (
            f"<tr><th>{html.escape(_STAGES.get(key, key))}</th><td>{_duration(known[key])}</td><td class='bars'>{bar}</td></tr>"
        )
    rows += f'<tr class="total"><th>All</th><td>{_duration(total)}</td><td></td></tr>'
    return _section("Time taken", f'<div class="wide"><table class="numbers timings">{rows}</table></div>')


def _warnings(run: _Run) -> str:
    warnings = [str(w) for w in run.capture.get("warnings") or []]
    failures = run.capture.get("failures") or {}
    parts = []
    if warnings:
        parts.append("<ul>" + "".join(f"<li>{html.escape(w)}</li>" for w in warnings) + "</ul>")
    if failures:
        cells = "".join(f"<tr><th>{html.escape(str(k))}</th><td>{html.escape(str(v))}</td></tr>" for k, v in failures.items())
        words = "1 frame was not used" if len(failures) == 1 else f"{len(failures)} frames were not used"
        state = " open" if len(failures) <= 10 else ""
        parts.append(f'<details{state}><summary>{words}</summary><div class="wide"><table>{cells}</table></div></details>')
    return _section("Warnings", "".join(parts)) if parts else ""


# --- pieces ---


def _section(title: str, inside: str) -> str:
    return f"<section><h2>{html.escape(title)}</h2>{inside}</section>" if inside else ""


def _missing(run: _Run, what: str) -> str:
    return f'<p class="missing">This run has no {html.escape(what)} yet. To make it: <code>{html.escape(run.command)}</code></p>'


def _facts(facts: Mapping[str, Any]) -> str:
    """A list of those that are not None."""
    rows = "".join(f"<div><dt>{k}</dt><dd>{html.escape(str(v))}</dd></div>" for k, v in facts.items() if v is not None)
    return f"<dl>{rows}</dl>" if rows else ""


def _figure(path: Path, caption: str, *, sharp: bool = False) -> str:
    """The picture inside the page, "" where there is no such file. `sharp` keeps thin coloured lines, which JPEG would smear."""
    if not path.is_file():
        return ""
    try:
        with Image.open(path) as opened:
            image = opened.convert("RGB")
    except OSError as error:
        raise RtgsError(f"{path}: not a picture that can be read ({error})") from error
    if image.width > PICTURE_WIDTH_PX:
        image = image.resize(
            (PICTURE_WIDTH_PX, max(1, round(image.height * PICTURE_WIDTH_PX / image.width))), Image.Resampling.LANCZOS
        )
    buffer = io.BytesIO()
    if sharp:
        image.save(buffer, "PNG", optimize=True)
    else:
        image.save(buffer, "JPEG", quality=88, optimize=True)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    kind = "png" if sharp else "jpeg"
    alt = html.escape(f"{path.name.removesuffix('.png')}: {caption}", quote=True)
    return (
        f'<figure style="flex:{image.width / image.height:.4f} 1 0">'
        f'<img src="data:image/{kind};base64,{data}" alt="{alt}" width="{image.width}" height="{image.height}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def _scores(run: _Run, model: str, name: str) -> str:
    values = _get(run.metrics, model, "per_frame", name)
    if not isinstance(values, dict):
        return ""
    units = {"psnr": " dB", "mae_c": " °C"}
    shown = [f"{_metric(m, values[m])}{units[m]}" for m in ("psnr", "mae_c") if _number(values.get(m)) is not None]
    return "".join(f" · {s}" for s in shown)


def _colour_bar(run: _Run) -> str:
    if run.range_c is None:
        return ""
    lo, hi = run.range_c
    colours = matplotlib.colormaps["inferno"](np.linspace(0, 1, 12))[:, :3]
    stops = ", ".join(matplotlib.colors.to_hex(c) for c in colours)
    ticks = "".join(f"<span>{t:.1f}{' ' + run.unit if run.unit else ''}</span>" for t in np.linspace(lo, hi, 5))
    return f'<div class="scale"><div style="background:linear-gradient(to right, {stops})"></div><p>{ticks}</p></div>'


def _solver(scale: Mapping[str, Any]) -> str | None:
    solver = scale.get("solver")
    return (
        None
        if solver is None
        else {"adam": "Adam", "gauss_newton": "Gauss-Newton", "global": "scan and Gauss-Newton"}.get(str(solver), str(solver))
    )


def _scan_chart(scale: Mapping[str, Any]) -> str:
    scan = scale.get("scan") or {}
    x, loss = _floats(scan.get("sfm_per_metre")), _floats(scan.get("loss"))
    if len(x) < 2 or len(x) != len(loss):
        return ""
    error = _floats(scan.get("std_error"))
    per_frame = [c for c in (_floats(v) for v in (scan.get("per_frame") or {}).values()) if len(c) == len(x)]
    if len(error) != len(x) and len(per_frame) > 1:
        error = np.std(per_frame, axis=0, ddof=1) / math.sqrt(len(per_frame))
    figure, axes = _axes("SfM units per metre", "loss")
    order = np.argsort(x)
    x, loss = x[order], loss[order]
    if len(error) == len(x):
        error = error[order]
        axes.fill_between(x, loss - error, loss + error, color=_CURVE, alpha=0.25, linewidth=0, label="± 1 s.e. over frames")
    axes.plot(x, loss, color=_CURVE, linewidth=1.6, marker="o" if len(x) < 60 else "", markersize=2.5, label="mean over frames")
    interval, chosen = _pair(scale.get("ci95")), _number(scale.get("sfm_per_metre"))
    if interval and interval[0] > 0:
        axes.axvspan(*interval, color=_CHOSEN, alpha=0.18, linewidth=0, label="95 % interval")
    if chosen and chosen > 0:
        axes.axvline(chosen, color=_CHOSEN, linewidth=1.4, label=f"chosen: {chosen:.4g}")
    for s, _ in _minima(scale):
        axes.axvline(s, color=_CHOSEN, linewidth=1.2, linestyle=":", label=f"other minimum: {s:.4g}")
    _log_axis(axes, "x", float(x.min()), float(x.max()))
    axes.legend(frameon=False, fontsize=8.5, labelcolor=_SVG_INK)
    return _chart(figure, "Loss over the scale: the scan")


def _minima(scale: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Scale and chance of every other minimum."""
    found = [(_number(m.get("sfm_per_metre")), _number(m.get("chance"))) for m in scale.get("minima") or []]
    return [(s, 0.0 if c is None else c) for s, c in found if s is not None and s > 0]


def _local_chart(scale: Mapping[str, Any]) -> str:
    """Loss above its minimum close to the answer: the mean, and each frame's."""
    local = scale.get("local") or {}
    x, loss = _floats(local.get("sfm_per_metre")), _floats(local.get("loss"))
    if len(x) < 2 or len(x) != len(loss):
        return ""
    lowest = int(np.argmin(loss))
    figure, axes = _axes("SfM units per metre", "loss above that of the answer")
    curves = [c for c in (_floats(v) for v in (local.get("per_frame") or {}).values()) if len(c) == len(x)]
    for k, curve in enumerate(curves):
        label = "single frames" if k == 0 else None
        axes.plot(x, curve - curve[lowest], color=_SVG_INK, alpha=0.18, linewidth=0.7, label=label)
    axes.plot(x, loss - loss[lowest], color=_CURVE, linewidth=1.6, marker="o", markersize=2.5, label="mean over frames")
    interval, chosen = _pair(scale.get("ci95")), _number(scale.get("sfm_per_metre"))
    if interval and interval[0] > 0:
        axes.axvspan(*interval, color=_CHOSEN, alpha=0.18, linewidth=0, label="95 % interval")
    if chosen and chosen > 0:
        axes.axvline(chosen, color=_CHOSEN, linewidth=1.4)
    rise = float(np.max(loss - loss[lowest]))
    if rise > 0:
        axes.set_ylim(-rise, 2 * rise)  # the mean decides; steeper frames may leave the picture
    axes.legend(frameon=False, fontsize=8.5, labelcolor=_SVG_INK)
    return _chart(figure, "Loss close to the answer: what the interval is taken from")


def _history_chart(scale: Mapping[str, Any]) -> str:
    history = scale.get("history") or {}
    step, value, loss = (_floats(history.get(k)) for k in ("step", "sfm_per_metre", "loss"))
    if len(step) < 2 or len(step) != len(value):
        return ""
    figure, axes = _axes("step", "SfM units per metre")
    axes.plot(step, value, color=_CHOSEN, linewidth=1.6, marker="o" if len(step) < 25 else "", markersize=3)
    _log_axis(axes, "y", float(value.min()), float(value.max()))
    axes.yaxis.label.set_color(_CHOSEN)
    if len(loss) == len(step):
        right = axes.twinx()
        right.plot(step, loss, color=_CURVE, linewidth=1.2)
        _plain(right)
        right.spines["right"].set_visible(True)
        right.set_ylabel("loss", color=_CURVE)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    return _chart(figure, f"Refinement by {_solver(scale) or 'the solver'}")


def _axes(x: str, y: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(5.4, 3.5), layout="constrained")
    axes = figure.subplots()
    _plain(axes)
    axes.set_xlabel(x, color=_SVG_INK)
    axes.set_ylabel(y, color=_SVG_INK)
    axes.grid(True, color=_SVG_INK, alpha=0.12, linewidth=0.6)
    return figure, axes


def _plain(axes: Axes) -> None:
    axes.tick_params(colors=_SVG_INK, which="both")
    for side, spine in axes.spines.items():
        spine.set_color(_SVG_INK)
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


def _chart(figure: Figure, caption: str) -> str:
    buffer = io.StringIO()
    # Text stays text (small, and in the page's own font); the salt makes ids the same on every run and different between charts.
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": caption, "font.family": "sans-serif"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    svg = buffer.getvalue()
    svg = re.sub(r'<g id="[^"]*">', "<g>", svg[svg.index("<svg") :])  # group names, alike in every chart; nothing refers to them
    svg = svg.replace(_SVG_INK, "currentColor")
    return f"<figure class='chart'>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>"


# --- values ---


def _json(path: Path) -> Mapping[str, Any]:
    if not path.is_file():
        return {}
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RtgsError(f"{path}: cannot be read as JSON ({error}); delete it and run the stage again") from error
    if not isinstance(value, dict):
        raise RtgsError(f"{path}: a JSON object is expected, found {type(value).__name__}; delete it and run the stage again")
    return value


def _get(value: Any, *keys: str) -> Any:
    for key in keys:
        if not isinstance(value, dict):
            return None
        value = value.get(key)
    return value


def _number(value: Any) -> float | None:
    """A finite number, or None for anything else: JSON's null, NaN, text."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return float(value)


def _pair(value: Any) -> tuple[float, float] | None:
    if not isinstance(value, (list, tuple)) or len(value) != 2:
        return None
    lo, hi = _number(value[0]), _number(value[1])
    return None if lo is None or hi is None else (lo, hi)


def _floats(value: Any) -> np.ndarray:
    """`[n]` float64, NaN where an entry is null; empty where there is no list."""
    if not isinstance(value, list):
        return np.zeros(0)
    return np.array([np.nan if _number(v) is None else float(v) for v in value])


def _evenly(count: int, at_most: int) -> Sequence[int]:
    if count <= at_most:
        return range(count)
    return [round(i * (count - 1) / (at_most - 1)) for i in range(at_most)]


def _flattened(settings: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, str]]:
    for key, value in settings.items():
        if isinstance(value, dict) and value:
            yield from _flattened(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _metric(name: str, value: Any) -> str:
    number = _number(value)
    return "–" if number is None else f"{number:.{_DECIMALS.get(name, 3)}f}"


def _signed(name: str, difference: float) -> str:
    return f"{difference:+.{_DECIMALS.get(name, 3)}f}".replace("-", "−")


def _size(value: Any) -> str | None:
    pair = _pair(value)
    return None if pair is None else f"{pair[0]:.0f} × {pair[1]:.0f} px"


def _length(metres: float) -> str:
    value, unit = (metres, "m") if metres >= 1 else (100 * metres, "cm") if metres >= 0.01 else (1000 * metres, "mm")
    return f"{value:.3g}\u00a0{unit}"


def _duration(seconds: float) -> str:
    if seconds < 10:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


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
table + p, .wide + p { margin-top: 14px; } section > :last-child { margin-bottom: 0; }
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
@media (max-width: 640px) { .pair { grid-template-columns: 1fr; } .triple { gap: 5px; } .triple figcaption { font-size: 0.7rem; }
  table.numbers td.bars { display: none; } dl { gap: 8px 12px; } }
"""
