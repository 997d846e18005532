"""Types of the command line's arguments, and where their defaults come from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, TypeAlias

import tyro

from rtgs.base.events import Listener
from rtgs.config import RunConfig
from rtgs.run.config_file import is_run, read_config

Folder: TypeAlias = tyro.conf.Positional[Path]
Flat = tyro.conf.arg(name="")  # a config's fields become flags without a prefix
Hidden: TypeAlias = Annotated[Listener, tyro.conf.Suppress]  # is no argument: the table of commands fills it in


def saved_settings(arguments: Sequence[str]) -> RunConfig:
    """Settings of the run that the command line names: a flag changes one of them, the others stay as they were."""
    command, rest = arguments[0] if arguments else "", list(arguments[1:])
    named: list[str] = []
    if command in ("run", "sfm"):
        named = [rest[i + 1] for i, a in enumerate(rest[:-1]) if a == "--out"]
        named += [a.removeprefix("--out=") for a in rest if a.startswith("--out=")]
    elif command in ("rgb", "scale", "thermal"):
        named = rest  # the run is the positional one, before the flags or after them
    for candidate in named:
        if is_run(Path(candidate)):
            return read_config(Path(candidate)).config
    return RunConfig()
