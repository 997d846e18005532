"""Section: the scale, its curves, and what of the calibration was refined with it."""

from __future__ import annotations

import html

from rtgs.base.text import first_upper
from rtgs.run.report.charts import history_chart, local_chart, scan_chart
from rtgs.run.report.pieces import facts, missing, section, wide
from rtgs.run.report.run_records import RunRecords
from rtgs.run.report.values import minus
from rtgs.scale import ScaleEstimate
from rtgs.scale.records import FoundRig, Freedom, Refinement

_SOLVERS = {"adam": "Adam", "global": "scan and Gauss-Newton"}


def scale_section(run: RunRecords) -> str:
    """Numbers, the solver's reason, curves and the refined calibration."""
    scale = run.scale
    if scale is None:
        return section("Scale", missing(run, "scale.json"))
    note = f"<p>{html.escape(first_upper(scale.reason))}</p>" if scale.reason else ""
    solver = _SOLVERS.get(scale.solver, scale.solver)
    second = local_chart(scale) if scale.solver == "global" else history_chart(scale, solver)
    seen = scale.calibration is None or scale.calibration.baseline_seen  # else curves over its length say nothing
    charts = [chart for chart in (scan_chart(scale), second) if chart and seen]
    pair = f'<div class="pair">{"".join(charts)}</div>' if charts else ""
    rig = _found_rig(scale.calibration) + _refinement(scale.refinement, found=scale.calibration is not None)
    return section("Scale", facts(_facts(scale, solver)) + note + pair + rig)


def _facts(scale: ScaleEstimate, solver: str) -> dict[str, str | int | None]:
    minima = [f"{m.sfm_per_metre:.4g} (better in {100 * m.chance:.2g} % of resamples)" for m in scale.minima]
    return {
        **_sfm_units(scale),
        "Metres per SfM unit": None if scale.metres_per_sfm is None else f"{scale.metres_per_sfm:.5g}",
        "Standard error": None if scale.std_log is None else f"{100 * scale.std_log:.2g} %",
        "95 % interval": None if scale.ci95 is None else f"{scale.ci95[0]:.5g} to {scale.ci95[1]:.5g}",
        "Searched": f"{scale.bracket[0]:.3g} to {scale.bracket[1]:.3g}",
        "Solver": solver,
        "Started at": f"{scale.init:.4g}",
        "Frames used": len(scale.frames),
        "Other minima": ", ".join(minima) or None,
        "Blur of the thermal lens": f"{scale.blur_px:.2g} px" if scale.blur_px else None,
        "Edges miss each other by": f"{scale.misfit_px:.2g} px" if scale.misfit_px else None,
        "Frames that disagree": ", ".join(scale.disagreeing) or None,
    }


def _sfm_units(scale: ScaleEstimate) -> dict[str, str]:
    """What places the thermal cameras; nothing where the images tell no baseline."""
    if scale.calibration is not None and not scale.calibration.baseline_seen:
        return {}
    per_metre = scale.calibration is None or scale.baseline_m is not None
    return {"SfM units per metre" if per_metre else "SfM units in the baseline": f"{scale.sfm_per_metre:.5g}"}


def _found_rig(found: FoundRig | None) -> str:
    """How the rig was found, where rig.json gives none; "" where it does."""
    if found is None:
        return ""
    known = "not told by the images"
    if found.baseline_sfm is not None and found.baseline_std_log is not None:
        known = f"{found.baseline_sfm:.4g} SfM units ± {100 * found.baseline_std_log:.2g} %"
    values = {
        "Baseline": known,
        "Loss without a baseline": f"{found.loss_without_baseline:.5f}",
        "Loss": f"{found.loss:.5f}",
        "Difference in standard errors": f"{found.significance:.3g}",
    }
    return "<p>rig.json gives no calibrated transform. The rig was found from the capture.</p>" + facts(values)


def _refinement(refinement: Refinement | None, *, found: bool) -> str:
    if refinement is None or not refinement.freedoms:
        return ""
    head = "<tr><td></td><th>calibration</th><th>found</th><th>decided by the images</th></tr>"
    rows = "".join(_freedom(f) for f in refinement.freedoms)
    said = "Every later stage uses the rig found. Values are changes from where the search started."
    if not found:
        said = (
            "The calibration was refined with the scale; every later stage uses the refined rig, and rig.json is as it was. Standard "
            f"deviations stand behind ±. Without this the scale would be {refinement.before:.5g} SfM units per metre."
        )
    return f"<p>{said}</p>" + wide(f"<thead>{head}</thead>{rows}", "numbers")


def _freedom(freedom: Freedom) -> str:
    unit = html.escape(freedom.unit)
    found = minus(f"{freedom.mean:+.3f} ± {freedom.std:.3f} {unit}")
    known = "yes" if freedom.decided else "no, as calibrated"
    cells = f"<td>0 ± {freedom.prior_std:.3g} {unit}</td><td>{found}</td><td>{known}</td>"
    return f"<tr><th>{html.escape(freedom.name)}</th>{cells}</tr>"
