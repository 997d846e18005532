"""`rtgs report`: the technical report again, or a report of an inspection."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from rtgs.base.errors import RtgsError
from rtgs.base.events import ResultLine, WarningLine, long_work
from rtgs.cli.options import Folder, Hidden


def report(
    run: Folder,
    listener: Hidden,
    template: Literal["technical", "inspection"] = "technical",
    out: Path | None = None,
    facts: Path | None = None,
    write_facts: Path | None = None,
    spots: Path | None = None,
    pdf: bool = False,
) -> None:
    """Write the technical report of a run again, or the report of an inspection: for the client, and to print.

    Args:
        run: the run folder.
        template: "technical" is what `rtgs run` writes; "inspection" has findings, pictures and what EN 13187 and IEC TS 62446-3 ask for.
        out: inspection: the file, which ends in .html; without it, RUN/inspection.html.
        facts: inspection: a JSON file with client, site, camera, weather and classes of severity.
        write_facts: inspection: write an empty file of facts here, and no report.
        spots: inspection: the folder that `rtgs spots` has written; without it, RUN/spots.
        pdf: inspection: a PDF beside the page too, by Chromium or Chrome where one is installed.
    """
    if template == "technical":
        _technical(
            run, listener, given={"--out": out, "--facts": facts, "--write-facts": write_facts, "--spots": spots, "--pdf": pdf}
        )
        return
    from rtgs.run.inspection import print_pdf, read_facts, write_empty_facts, write_inspection

    if write_facts is not None:
        write_empty_facts(write_facts)
        listener(
            ResultLine(
                f"wrote {write_facts}: fill in what is known, then `rtgs report {run} --template inspection --facts {write_facts}`"
            )
        )
        return
    stated = None if facts is None else read_facts(facts)
    with long_work(listener, "report", "sections") as progress:
        page = write_inspection(
            run, run / "inspection.html" if out is None else out, facts=stated, spots=spots, progress=progress
        )
    listener(ResultLine(f"report: {page}"))
    if pdf:
        listener(ResultLine(f"PDF: {print_pdf(page)}"))


def _technical(run: Path, listener: Hidden, given: dict[str, object]) -> None:
    from rtgs.run.config_file import check_run
    from rtgs.run.report import write_report
    from rtgs.run.report.run_records import RunRecords
    from rtgs.run.stages import not_made

    check_run(run)
    named = [flag for flag, value in given.items() if value not in (None, False)]
    if named:
        raise RtgsError(f"{named[0]}: belongs to the inspection report; add `--template inspection`.")
    listener(ResultLine(f"report: {write_report(run)}"))
    missing = [file for files in not_made(run).values() for file in files]
    if missing:
        listener(WarningLine(f"{run}: has no {', '.join(missing)}. `{RunRecords.read(run).command}` makes what is missing."))
