"""The top of the page: the scale, and what it brought, in a few sentences."""

from __future__ import annotations

import html

from rtgs.base.text import first_upper
from rtgs.run.report.run_records import RunRecords
from rtgs.run.report.values import length

_STATUS = {
    "ok": ("good", "Scale found"),
    "ambiguous": ("fair", "Scale ambiguous"),
    "unobservable": ("poor", "Scale cannot be observed"),
}
_ALIKE_DB = 0.05  # models that differ by less are said to be equal: the sentence shows one decimal


def verdict_header(run: RunRecords) -> str:
    """Title, badge and sentences."""
    badge, said = _scale(run)
    said += _thermal(run)
    title = html.escape(page_title(run))
    return f'<header><h1>{title}</h1>{badge}<p class="verdict">{" ".join(said)}</p></header>'


def page_title(run: RunRecords) -> str:
    """What the page is called, as text."""
    return f"RGB–thermal model of {run.name}"


def _scale(run: RunRecords) -> tuple[str, list[str]]:
    scale = run.scale
    if scale is None:
        return '<span class="badge none">Scale not estimated yet</span>', ["This run has no scale so far."]
    colour, words = _STATUS[scale.status]
    metres = scale.metres if scale.metres is not None and scale.metres.sfm_per_metre is not None else None
    if scale.metres_per_sfm is None:
        return '<span class="badge poor">No metres</span>', [f"{html.escape(first_upper(scale.no_metres))}"]
    elsewhere = metres is not None and metres.rests_on != ("baseline",)
    interval = scale.metres_ci95
    sentence = f"One metre is <strong>{1 / scale.metres_per_sfm:.4g} SfM units</strong>"
    if interval:
        sentence += f" (95 % interval {interval[0]:.4g} to {interval[1]:.4g})"
    if metres is not None and elsewhere:
        sentence += f", from {' and '.join(html.escape(name) for name in metres.rests_on)}"
    elif run.baseline_m:
        spans = run.baseline_m * scale.sfm_per_metre
        sentence += f"; the rig's baseline of {length(run.baseline_m)} spans {spans:.3g} of them"
    said = [sentence + "."]
    if metres is not None and metres.disagreement:
        first = html.escape(first_upper(metres.disagreement))
        return '<span class="badge poor">Sources of metres disagree</span>', [f"<strong>{first}</strong>", *said]
    if scale.status != "ok" and not scale.doubt:
        colour, words = "fair", "Metres without the baseline"
        said.append(f"The baseline tells no metres: {html.escape(scale.reason.rstrip('.'))}.")
    elif scale.status != "ok":
        reason = scale.reason.rstrip(".")
        said.append("Do not rely on this number" + (f": {html.escape(reason)}." if reason else "."))
    return f'<span class="badge {colour}">{html.escape(words)}</span>', said


def _thermal(run: RunRecords) -> list[str]:
    evaluation = run.evaluation
    if evaluation is None or evaluation.thermal.psnr is None:
        return []
    thermal, naive = evaluation.thermal, evaluation.thermal_naive
    sentence = f"On views it never saw, the thermal model reaches <strong>{thermal.psnr:.1f}\u00a0dB</strong>"
    if naive is not None and naive.psnr is not None and thermal.psnr is not None:
        gain = thermal.psnr - naive.psnr
        if abs(gain) < _ALIKE_DB:
            sentence += ", neither better nor worse than with the scale ignored (s = 1)"
        else:
            better = "better" if gain > 0 else "worse"
            sentence += f", <strong>{abs(gain):.1f}\u00a0dB {better}</strong> than with the scale ignored"
    if thermal.mae_c is not None:
        sentence += f"; its temperatures are off by <strong>{thermal.mae_c:.2f}\u00a0°C</strong> on average"
    said = [sentence + "."]
    if run.unit == "counts":
        said.append("The capture has no radiometric calibration, so thermal values are relative, not degrees.")
    return said
