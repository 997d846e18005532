"""`rtgs doctor`: what can be said of a capture before any work."""

from __future__ import annotations

import json
import sys
from typing import Annotated

import tyro

from rtgs.base.events import ResultLine, WarningLine, long_work, nobody
from rtgs.cli.options import Folder, Hidden

DOUBTFUL, UNUSABLE = 3, 2
_WORDS = {
    "good": "nothing speaks against this capture",
    "doubtful": "a run is possible, and its results will suffer from what the warnings say",
    "unusable": "a run is not possible",
}


def doctor(capture: Folder, listener: Hidden, *, as_json: Annotated[bool, tyro.conf.Suppress] = False) -> None:
    """Examine a capture before any work: files, times, sharpness, overlap, thermal images, calibration, and what metres will rest on.

    The exit code is 0 where nothing speaks against the capture, 3 with warnings, and 2 where a run is not possible.

    Args:
        capture: folder with rgb/, thermal/ and rig.json, and poses if there are any.
    """
    from rtgs.base.json_records import to_json
    from rtgs.doctor import examine
    from rtgs.run.config_file import refuse_run

    refuse_run(capture)
    with long_work(nobody if as_json else listener, "doctor", "examination") as progress:
        diagnosis = examine(capture, progress=progress)
    if as_json:
        print(json.dumps(to_json(diagnosis), indent=1, ensure_ascii=False))
    else:
        for finding in diagnosis.findings:
            line = f"{finding.check}: {finding.text.rstrip('.')}. {finding.remedy}".strip()
            if finding.level == "warning":
                listener(WarningLine(line))
            else:
                listener(ResultLine(f"error: {line}" if finding.level == "error" else line))
        listener(ResultLine(f"verdict: {diagnosis.verdict}; {_WORDS[diagnosis.verdict]}"))
    code = {"good": 0, "doubtful": DOUBTFUL, "unusable": UNUSABLE}[diagnosis.verdict]
    if code:
        sys.exit(code)
