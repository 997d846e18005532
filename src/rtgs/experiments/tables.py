"""Tables of the synthetic experiment: statistics of its records as Markdown and CSV, and the figures beside them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rtgs.base.csv_files import write_records_csv
from rtgs.config import SyntheticExperimentConfig
from rtgs.experiments.ablation import ABLATION
from rtgs.experiments.figures import draw_errors
from rtgs.experiments.methods import METHODS, MI_WITHOUT_REPLAY
from rtgs.experiments.provenance import Page, Provenance, command_line
from rtgs.experiments.records import ExperimentFolder, Record
from rtgs.experiments.rivals import MUTUAL_INFORMATION, NGF_PYRAMID, OURS, OURS_REFINED, RIVALS
from rtgs.experiments.trials import SceneFacts
from rtgs.experiments.variants import FAR, FAR_SCENE, REFERENCE, ROWS, Variant
from rtgs.records.capture import Split

SUCCESS_PCT = 2.0
_COLUMNS = METHODS["2"]  # of Table II and of what goes beyond the paper, which has fewer of them
TITLES = {**{r.key: r.title for r in RIVALS}, **{method.key: method.title for method in (OURS, OURS_REFINED)}}


@dataclass(frozen=True)
class Summary:
    """Statistics of one method's trials on a row.

    Attributes:
        method: its key. trials: how many.
        median_pct, p90_pct: of the scale's error, per cent. success_pct: share of trials with an error up to `SUCCESS_PCT`.
        iterations, renders, seconds: medians; NaN for the starts themselves.
    """

    method: str
    trials: int
    median_pct: float
    p90_pct: float
    success_pct: float
    iterations: float
    renders: float
    seconds: float

    @staticmethod
    def of(method: str, records: Sequence[Record], *, product: bool = False) -> Summary:
        """From at least one record. product: errors of s·|t| instead of s."""
        errors = np.array([r.product_error_pct if product else r.error_pct for r in records])
        return Summary(
            method,
            len(records),
            float(np.median(errors)),
            float(np.percentile(errors, 90)),
            100 * float(np.mean(errors <= SUCCESS_PCT)),
            float(np.median([r.iterations for r in records])),
            float(np.median([r.renders for r in records])),
            float(np.median([r.seconds for r in records])),
        )

    @staticmethod
    def of_starts(records: Sequence[Record]) -> Summary:
        """Errors of the starts, before any method has run."""
        errors = np.array([100 * abs(r.start / r.truth - 1) for r in records])
        success = 100 * float(np.mean(errors <= SUCCESS_PCT))
        nothing = (math.nan, math.nan, math.nan)
        return Summary("init", len(records), float(np.median(errors)), float(np.percentile(errors, 90)), success, *nothing)


def write_tables(folder: ExperimentFolder, config: SyntheticExperimentConfig) -> list[Path]:
    """Write Markdown, CSV and figures of the tables that are asked for, from the records that are there; returns the paths."""
    records = [r for r in folder.records() if r.scene in (*config.scenes, FAR_SCENE) and r.seed < config.seeds]
    written = [write_records_csv(folder.path / "trials.csv", Record, records)]
    command = "rtgs experiment synthetic --out DIR"
    provenance = Provenance.of(command_line(command, config, SyntheticExperimentConfig()))
    for table in config.tables:
        if table == "1":
            page, summaries = table_1(records, config)
            page = Page(page.title, page.body + "\n" + scene_table(folder, config))
            written.append(write_records_csv(folder.path / "table1.csv", Summary, summaries))
            written += draw_errors(folder.path, [r for r in records if r.variant == REFERENCE and r.method in TITLES], TITLES)
        elif table == "ablation":
            page = ablation_table(records, config)
        else:
            rows = (*ROWS[table], FAR) if table == "beyond" else ROWS[table]
            here = [r for r in records if r.variant in {row.key for row in rows} and r.method in _COLUMNS]
            title = "Table II: sensitivity" if table == "2" else "Beyond the paper"
            page = Page(f"{title}{_where(here, config)}", rows_table(here, rows))
        written.append(page.write(folder.path / f"table_{table}.md", provenance))
    return written


def table_1(records: Sequence[Record], config: SyntheticExperimentConfig) -> tuple[Page, list[Summary]]:
    """Table I: the page, and its rows as statistics."""
    here = [r for r in records if r.variant == REFERENCE]
    groups = {key: [r for r in here if r.method == key] for key in TITLES}
    most = max(groups.values(), key=len)
    summaries = [Summary.of_starts(most)] if most else []
    summaries += [Summary.of(key, found) for key, found in groups.items() if found]
    lines = ["| method | trials | Med % | P90 % | SR@2 % | iterations | renders | seconds, one core |", "|---|" + "---:|" * 7]
    for s in summaries:
        counts = ["–"] * 3 if math.isnan(s.renders) else [f"{s.iterations:.0f}", f"{s.renders:,.0f}", f"{s.seconds:.1f}"]
        title = TITLES.get(s.method, "Init")
        lines.append(
            f"| {title} | {s.trials} | {s.median_pct:.2f} | {s.p90_pct:.2f} | {s.success_pct:.0f} | " + " | ".join(counts) + " |"
        )
    lines += ["", *_comparison(groups), *_checks(here)]
    return Page(f"Table I: scale recovery{_where(here, config)}", "\n".join(lines) + "\n"), summaries


def rows_table(records: Sequence[Record], rows: Sequence[Variant]) -> str:
    """Median error and success rate of each method, one line a row of the table, in Markdown."""
    methods = [key for key in _COLUMNS if any(r.method == key for r in records)]
    lines = ["Med % / SR@2 %, of s; in brackets Med % of s·|t|, where the rig's length is off.", ""]
    lines += [
        "| perturbation | level | " + " | ".join(TITLES.get(m, m) for m in methods) + " |",
        "|---|---|" + "---:|" * len(methods),
    ]
    for row in rows:
        cells = []
        for method in methods:
            found = [r for r in records if r.variant == row.key and r.method == method]
            if not found:
                cells.append("–")
                continue
            own = Summary.of(method, found)
            cell = f"{own.median_pct:.2f} / {own.success_pct:.0f}"
            if row.length_factor != 1.0:
                cell += f" ({Summary.of(method, found, product=True).median_pct:.2f})"
            verdicts = [r.status for r in found if r.status != "ok"]
            cells.append(cell + (f"; {len(verdicts)} of {len(found)} {verdicts[0]}" if verdicts else ""))
        lines.append(f"| {row.title} | {row.level} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def ablation_table(records: Sequence[Record], config: SyntheticExperimentConfig) -> Page:
    """The search with its defaults, and with one setting changed at a time."""
    methods = (OURS, *ABLATION)
    here = [r for r in records if r.variant == REFERENCE and r.method in {m.key for m in methods}]
    lines = [
        "| changed | Med % | P90 % | worst % | SR@2 % | half-width % | renders | seconds, one core |",
        "|---|" + "---:|" * 7,
    ]
    for method in methods:
        found = [r for r in here if r.method == method.key]
        if found:
            own = Summary.of(method.key, found)
            widths = [r.half_width_pct for r in found if r.half_width_pct is not None]
            width = f"{np.median(widths):.2f}" if widths else "–"
            worst = max(r.error_pct for r in found)
            lines.append(
                f"| {'nothing' if method is OURS else method.title} | {own.median_pct:.3f} | {own.p90_pct:.3f} | {worst:.3f} "
                f"| {own.success_pct:.0f} | {width} | {own.renders:,.0f} | {own.seconds:.1f} |"
            )
    return Page(f"Ablation of the search{_where(here, config)}", "\n".join(lines) + "\n")


def scene_table(folder: ExperimentFolder, config: SyntheticExperimentConfig) -> str:
    """How many points and Gaussians each scene's RGB model has, and how good it is, in Markdown."""
    lines = ["| scene | points | Gaussians | RGB held out, dB |", "|---|---:|---:|---:|"]
    for name in config.scenes:
        facts = SceneFacts.read(folder.scene(name))
        lines.append(f"| {name} | {facts.points:,} | {facts.gaussians:,} | {facts.psnr_db:.2f} |")
    return "\n".join(lines) + "\n"


def _where(records: Sequence[Record], config: SyntheticExperimentConfig) -> str:
    trials = {(r.scene, r.seed) for r in records if r.scene != FAR_SCENE}
    scenes, seeds = len({scene for scene, _ in trials}), len({seed for _, seed in trials})
    training = config.frames - len(Split().held_out_names([str(i) for i in range(config.frames)]))
    return f" at {config.size} × {config.size}, {config.frames} pairs of which {training} for training, " + (
        f"{scenes} scenes × {seeds} seeds" if len(trials) == scenes * seeds else f"{len(trials)} trials on {scenes} scenes"
    )


def _comparison(groups: dict[str, list[Record]]) -> list[str]:
    """One line: the trial where this method loses most against the paper's, and how often its interval holds the truth."""
    text = []
    paper = {(r.scene, r.seed): r.error_pct for r in groups[NGF_PYRAMID.key]}
    paired = [(r.error_pct - paper[r.scene, r.seed], r) for r in groups[OURS.key] if (r.scene, r.seed) in paper]
    if paired:
        excess, worst = max(paired, key=lambda pair: pair[0])
        where = f"{worst.scene}, seed {worst.seed}: {worst.error_pct:.2f} %"
        text.append(f"Ours less the paper's Adam on the same {len(paired)} trials: at most {excess:+.2f} points ({where}).")
    known = [(abs(math.log(r.found / r.truth)) * 100, r.half_width_pct) for r in groups[OURS.key] if r.half_width_pct is not None]
    if known:
        inside, width = sum(error <= half for error, half in known), np.median([half for _, half in known])
        text.append(f"Its 95 % interval: median half-width {width:.2f} %, the truth inside in {inside} of {len(known)}.")
    return [" ".join(text), ""] if text else []


def _checks(records: Sequence[Record]) -> list[str]:
    """One line: how far replays are from runs that rendered at every step."""
    replayed = {(r.scene, r.seed): r for r in records if r.method == MUTUAL_INFORMATION.key}
    runs = [(r, replayed[r.scene, r.seed]) for r in records if r.method == MI_WITHOUT_REPLAY and (r.scene, r.seed) in replayed]
    if not runs:
        return []
    apart = max(100 * abs(run.found - replay.found) / run.truth for run, replay in runs)
    seconds = np.median([run.seconds for run, _ in runs])
    return [
        f"Descents on NGF render at every step; the others are replayed on curves rendered once. {len(runs)} of those on mutual "
        f"information were also run at every step ({seconds:.0f} s of one core each): at most {apart:.3f} points of s apart.",
        "",
    ]
