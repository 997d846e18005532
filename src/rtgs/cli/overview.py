"""`rtgs --help`: the commands by what one wants to do, with examples."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rtgs.cli.manners import FLAGS

GROUPS: Mapping[str, tuple[str, ...]] = {
    "Make a capture": ("import", "calibrate", "doctor", "synth"),
    "Run the method": ("run", "demo"),
    "One stage at a time": ("sfm", "rgb", "scale", "thermal", "eval"),
    "Use the result": ("view", "render", "spots", "report", "export", "share", "info"),
    "Measure the method": ("experiment",),
}

EXAMPLES = (
    ("rtgs demo", "the whole method on a small made-up capture"),
    ("rtgs import flir photographs --out capture", "radiometric JPEGs become a capture"),
    ("rtgs doctor capture", "whether it will work, in seconds"),
    ("rtgs run capture --out run", "the whole method; run/report.html is the result"),
    ("rtgs run capture --out run --scale.solver adam", "again from the scale on, with another solver"),
    ("rtgs spots run --out spots --above 60", "what is warmer than 60 °C"),
    ("rtgs report run --template inspection --facts facts.json", "a report for the client"),
    ("rtgs export run --out model --format glb points-laz", "for other programs, in metres"),
    ("rtgs share run --out model.html", "a page to send"),
    ("rtgs info run/thermal.ply", "what a file is"),
)


def text_of(about: str, commands: Mapping[str, Callable[..., Any]]) -> str:
    """The text of `rtgs --help`. Commands that no group names stand in a group of their own."""
    groups = dict(GROUPS)
    others = tuple(name for name in commands if not any(name in names for names in groups.values()))
    if others:
        groups["Others"] = others
    width = max(map(len, commands)) + 2
    parts = ["usage: rtgs COMMAND [OPTIONS]", "", about]
    for title, names in groups.items():
        parts += ["", f"{title}:"]
        parts += [f"  {name:{width}}{_first_line(commands[name])}" for name in names if name in commands]
    parts += ["", "With every command:"]
    parts += [f"  {flag:{width}}{text}" for flag, text in {"--help": "all options, with their defaults", **FLAGS}.items()]
    wide = max(len(example) for example, _ in EXAMPLES) + 2
    parts += ["", "Examples:", *(f"  {example:{wide}}{text}" for example, text in EXAMPLES)]
    parts += ["", "Completion in the shell:", '  eval "$(rtgs --tyro-print-completion bash)"    likewise zsh, tcsh']
    return "\n".join(parts)


def _first_line(command: Callable[..., Any]) -> str:
    function = command.func if isinstance(command, partial) else command
    return (inspect.getdoc(function) or "").partition("\n")[0]
