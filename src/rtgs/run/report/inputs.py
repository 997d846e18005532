"""Sections: what was run, and what a person should know about the capture."""

from __future__ import annotations

import html

from rtgs.base.json_records import to_json
from rtgs.run.report.pieces import facts, missing, section, wide
from rtgs.run.report.run_records import RunRecords
from rtgs.run.report.values import flattened, length, size

_FEW_FAILURES = 10  # listed without a click


def inputs_section(run: RunRecords) -> str:
    """The capture, the version and every setting."""
    summary = run.summary
    values: dict[str, object] = {"Capture": run.capture}
    if summary is not None:
        values |= {
            "Frames": f"{summary.frames}, of which {summary.registered} registered",
            "RGB image": size(summary.rgb_size),
            "Thermal image": size(summary.thermal_size),
            "Thermal unit": summary.unit,
            "Baseline": length(summary.baseline_m) if summary.baseline_m else None,
        }
    inside = facts(values | {"rtgs": run.version}) + _rgb_camera(run) + _settings(run)
    absent = [name for name, part in (("config.json", run.settings), ("capture_summary.json", summary)) if part is None]
    if run.older:
        inside += f"<p>{html.escape(_older(run))}</p>"
    return section("What was run", inside + (missing(run, " and ".join(absent)) if absent else ""))


def _older(run: RunRecords) -> str:
    stages = ", ".join(run.older)
    return (
        f"Results of earlier settings or of an earlier capture: {stages}. They are shown until `{run.command}` has replaced them."
    )


def _rgb_camera(run: RunRecords) -> str:
    """What structure from motion found of the RGB camera; "" where nothing was to be found."""
    found = None if run.summary is None else run.summary.rgb_camera
    if found is None:
        return ""
    head = "<tr><td></td><th>assumed</th><th>found</th></tr>"
    rows = [
        f"<tr><th>{html.escape(v.name)}</th><td>{v.assumed:.6g}</td><td>{v.found:.6g}{'' if v.std is None else f' ± {v.std:.2g}'}</td></tr>"
        for v in found.values
    ]
    return (
        f"<p>rig.json does not give all of the RGB camera ({html.escape(found.camera.model)}). Structure from motion started from "
        f"{html.escape(found.source)}. Standard deviations stand behind ±.</p>"
        + wide(f"<thead>{head}</thead>{''.join(rows)}", "numbers")
    )


def _settings(run: RunRecords) -> str:
    if run.settings is None:
        return ""
    settings = list(flattened(to_json(run.settings)))
    cells = "".join(f"<tr><td><code>{html.escape(k)}</code></td><td>{html.escape(v)}</td></tr>" for k, v in settings)
    return f"<details><summary>All {len(settings)} settings</summary>{wide(cells)}</details>"


def warnings_section(run: RunRecords) -> str:
    """Warnings about the capture, and the frames that were not used; "" where there are none."""
    if run.summary is None:
        return ""
    parts, failures = [], run.summary.failures
    if run.summary.warnings:
        parts.append("<ul>" + "".join(f"<li>{html.escape(w)}</li>" for w in run.summary.warnings) + "</ul>")
    if failures:
        cells = "".join(f"<tr><th>{html.escape(k)}</th><td>{html.escape(v)}</td></tr>" for k, v in failures.items())
        words = "1 frame was not used" if len(failures) == 1 else f"{len(failures)} frames were not used"
        state = " open" if len(failures) <= _FEW_FAILURES else ""
        parts.append(f"<details{state}><summary>{words}</summary>{wide(cells)}</details>")
    return section("Warnings", "".join(parts))
