"""`rtgs info`: what a file or a folder is."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import tyro

from rtgs.base.events import ResultLine
from rtgs.cli.options import Hidden


def info(
    path: Annotated[Path, tyro.conf.Positional], listener: Hidden, *, as_json: Annotated[bool, tyro.conf.Suppress] = False
) -> None:
    """Say what a file or a folder is, and what it holds: a run, a capture, a model, a picture, any JSON file of a run.

    Args:
        path: the file or folder.
    """
    from rtgs.run import info as facts_of

    facts = facts_of.describe(path)
    if as_json:
        sys.stdout.write(facts_of.as_json(facts) + "\n")
        return
    for line in facts_of.lines(facts):
        listener(ResultLine(line))
