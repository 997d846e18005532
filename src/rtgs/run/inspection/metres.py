"""Sections: what lengths rest on, what accuracy may be claimed, and warnings."""

from __future__ import annotations

import html

from rtgs.base.text import first_upper
from rtgs.metrics.scores import SCORES
from rtgs.run.inspection.inspection import Inspection
from rtgs.run.inspection.order import differing
from rtgs.run.inspection.pieces import card, lines, paragraph
from rtgs.run.report.metres import source_title
from rtgs.run.report.values import amount, length

_MOST_FAILURES = 10


def interval(report: Inspection) -> tuple[float, float, float] | None:
    """Units of the model per metre as lengths use it, and its 95 % interval; None where it is not known."""
    scale = report.run.scale
    if scale is None or scale.doubt:
        return None
    metres = scale.metres if scale.metres is not None and scale.metres.sfm_per_metre is not None else None
    found = scale.ci95 if metres is None else metres.ci95
    return None if found is None or scale.metres_per_sfm is None else (1 / scale.metres_per_sfm, *found)


def scale_section(report: Inspection) -> str:
    """The scale with its interval, and its sources."""
    words, scale = report.words, report.run.scale
    if scale is None:
        missing = words("missing", what="scale.json", command=report.run.command)
        return card(words, "scale", paragraph(missing, "doubt"))
    said = paragraph(words("scale.doubt", doubt=scale.doubt), "doubt") if scale.doubt else ""
    said += paragraph(words("scale.value", value=f"{1 / scale.unit_per_sfm:.5g}") + " " + _interval_text(report))
    metres = scale.metres
    if metres is None or not metres.sources:
        baseline = report.run.baseline_m
        said += paragraph(words("scale.baseline", baseline=length(baseline))) if baseline else ""
        return card(words, "scale", said)
    rests = ", ".join(source_title(name) for name in metres.rests_on) or words.plain("none")
    said += paragraph(words("scale.rests", sources=rests))
    facts = [words("scale.source", name=source_title(s.name), explanation=s.explanation) for s in metres.sources]
    facts += [words("scale.absent", name=source_title(name), why=why) for name, why in metres.absent.items()]
    return card(words, "scale", said + lines(facts))


def _interval_text(report: Inspection) -> str:
    found = interval(report)
    if found is None:
        doubt = report.run.scale is not None and report.run.scale.doubt
        return report.words("scale.in_doubt") if doubt else report.words("scale.no_interval")
    value, low, high = found
    # A length is proportional to 1 / value: it is longest at the low end.
    above, below = (f"{100 * abs(value / end - 1):.2g}" for end in (low, high))
    return report.words("scale.interval", low=f"{low:.5g}", high=f"{high:.5g}", above=above, below=below)


def accuracy_section(report: Inspection) -> str:
    """What the errors of the run are, what they leave out, and so what may be claimed."""
    words = report.words
    if report.run.unit == "counts":
        return card(words, "accuracy", lines([words("accuracy.counts"), words("accuracy.lengths")]))
    stated, used = report.facts.camera.accuracy, report.used
    said = [
        *_of_model(report),
        *_of_findings(report),
        words("accuracy.camera", accuracy=stated) if stated else words("accuracy.no_camera"),
        words("accuracy.differences"),
        words("accuracy.no_emissivity") if used is None else words("accuracy.emissivity", emissivity=f"{used.emissivity:g}"),
        words("accuracy.lengths"),
    ]
    return card(words, "accuracy", lines(said))


def _of_model(report: Inspection) -> list[str]:
    words, evaluation = report.words, report.run.evaluation
    if evaluation is None or evaluation.thermal.mae_c is None:
        return [words("accuracy.no_metrics", command=report.run.command)]
    thermal = evaluation.thermal
    assert thermal.mae_c is not None
    said = [words("accuracy.held_out", count=len(thermal.per_frame), mae=SCORES["mae_c"].text(thermal.mae_c))]
    if thermal.peak_c is not None:
        said.append(words("accuracy.peak", peak=SCORES["peak_c"].text(thermal.peak_c)))
    if thermal.peak_p90_c is not None:
        said.append(words("accuracy.peak90", p90=SCORES["peak_p90_c"].text(thermal.peak_p90_c)))
    return said


def _of_findings(report: Inspection) -> list[str]:
    words, listed = report.words, report.spots
    if listed is None or not listed.spots:
        return []
    said, numbered = [], list(enumerate(listed.spots, start=1))
    known = [spot.std for spot in listed.spots if spot.std is not None]
    if known:
        low, high = (amount(end(known), listed.unit, 2) for end in (min, max))
        said.append(words("accuracy.findings", low=low, high=high))
    single = [str(number) for number, spot in numbered if spot.std is None]
    differs = [str(number) for number, spot in numbered if spot.model_differs]
    if single:
        said.append(words("accuracy.single", numbers=", ".join(single)))
    if differs:
        said.append(words("accuracy.differs", numbers=", ".join(differs)))
    return said


def warnings_section(report: Inspection) -> str:
    """What a reader should know: doubts about lengths, settings that differ, warnings about the capture."""
    words, run, said = report.words, report.run, []
    if run.scale is not None and run.scale.doubt:
        said.append(words("warnings.scale", doubt=run.scale.doubt))
    if run.older:
        said.append(words("warnings.older", stages=", ".join(run.older), command=run.command))
    if report.spots is not None and report.spots_are_older:
        said.append(words("findings.older", command=report.spots_command))
    said += differing(report)
    if run.summary is not None:
        said += [html.escape(first_upper(warning)) for warning in run.summary.warnings]
    for finding in report.diagnosis.findings if report.diagnosis is not None else ():
        if finding.level != "note":
            said.append(words("warnings.doctor", check=finding.check, text=finding.text.rstrip("."), remedy=finding.remedy))
    if run.summary is not None:
        failures = list(run.summary.failures.items())
        said += [words("warnings.failure", name=name, why=why) for name, why in failures[:_MOST_FAILURES]]
        if len(failures) > _MOST_FAILURES:
            said.append(words("warnings.failures", count=len(failures) - _MOST_FAILURES))
    return card(words, "warnings", lines(said) if said else paragraph(words("none")))
