"""Flags that every command knows: how much it says, in which form, and what an error shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

FLAGS = {
    "--quiet": "say nothing but warnings and errors",
    "--json": "print results as JSON: one object a line; `rtgs info` and `rtgs doctor` print one object",
    "--debug": "show the traceback behind an error",
}


@dataclass(frozen=True)
class Manners:
    """Which of `FLAGS` were given."""

    quiet: bool = False
    json: bool = False
    debug: bool = False


def taken_out(arguments: Sequence[str]) -> tuple[Manners, list[str]]:
    """The flags of every command, and the arguments that are left. After `--` nothing is a flag."""
    end = list(arguments).index("--") if "--" in arguments else len(arguments)
    flags, rest = arguments[:end], list(arguments[end:])
    given = {flag.removeprefix("--"): flag in flags for flag in FLAGS}
    return Manners(**given), [a for a in flags if a not in FLAGS] + rest
