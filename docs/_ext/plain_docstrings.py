"""Docstrings in this package are plain text with `code` and *titles*; Sphinx expects reStructuredText. This turns one into the other.

Code in single backticks becomes literal text, formulas set apart by indentation become literal blocks, and characters that
reStructuredText would take for markup are escaped. Two readings of Sphinx's own are kept away: a colon in the docstring of an attribute
does not end a type, and names that share an entry of "Attributes:" stay one entry.
"""

from __future__ import annotations

import dataclasses
import importlib
import re
from typing import Any, get_type_hints

from sphinx.application import Sphinx

_SECTIONS = ("Args:", "Returns:", "Raises:", "Attributes:", "Yields:")
_ATTRIBUTES: dict[str, list[str]] = {}
_NAMES = re.compile(r"^    (\w+(?:(?:, | … )\w+)+):(?= )")
_CODE = re.compile(r"``?([^`]+)``?")
_TITLE = re.compile(r"(?<![\w*])\*([^*\s](?:[^*]*[^*\s])?)\*(?![\w*])")


def plain(text: str) -> str:
    """One line: what is neither code nor a title is escaped."""
    parts, at = [], 0
    for code in _CODE.finditer(text):
        parts += [_escaped(text[at : code.start()]), f"``{code.group(1).strip()}``"]
        at = code.end()
        if at < len(text) and (text[at].isalnum() or text[at] in "_’"):
            parts.append("\\ ")
    return "".join([*parts, _escaped(text[at:])])


def _escaped(text: str) -> str:
    titles = [m.group(0) for m in _TITLE.finditer(text)]
    rest = _TITLE.split(text)
    out = []
    for i, piece in enumerate(rest):
        out.append(titles[i // 2] if i % 2 else re.sub(r"([|*\\])|(?<=\w)(_)(?!\w)", r"\\\1\2", piece))
    return "".join(out)


def converted(lines: list[str]) -> list[str]:
    """A docstring, line by line."""
    out: list[str] = []
    literal = in_section = False
    for i, line in enumerate(lines):
        indented, blank_before = line.startswith("    "), i > 0 and not lines[i - 1].strip()
        if line.strip() in _SECTIONS and not indented:
            in_section, literal = True, False
            out.append(line)
            continue
        if line.strip() and not indented:
            in_section = literal = False
        if not in_section and indented and (literal or blank_before):
            if not literal:
                out += ["::", ""]
                literal = True
            out.append(line)
        else:
            names = _NAMES.match(line) if in_section else None
            if names:  # a blank would make the first name the type of the second
                line = line.replace(names[1], names[1].replace(" ", ""), 1)
            out.append(line if not line.strip() else plain(line))
    return out


def _convert(app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]) -> None:
    lines[:] = converted(lines)
    if what in ("attribute", "property"):
        _ATTRIBUTES[name] = list(lines)


def _restore(app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]) -> None:
    """Undo what napoleon does to attributes: it takes what stands before a colon in the first line for the type."""
    if name in _ATTRIBUTES:
        lines[:] = _ATTRIBUTES.pop(name)


def _without_limits(app: Sphinx) -> None:
    """Settings are annotated with their limits, for the command line. Here only their types are shown."""
    for module in (importlib.import_module(f"rtgs.config.{name}") for name in ("rgb", "scale", "sfm", "thermal")):
        for record in filter(dataclasses.is_dataclass, vars(module).values()):
            hints = get_type_hints(record)
            record.__annotations__ = hints
            record.__init__.__annotations__ = {**hints, "return": None}


def _signature(
    app: Sphinx, what: str, name: str, obj: object, options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Defaults that are made anew are shown as "..."; "<factory>" is not Python, and Sphinx would print the whole signature raw."""
    return (signature.replace("<factory>", "...") if signature else signature), returned


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("autodoc-process-docstring", _convert, priority=100)  # before napoleon reads the sections
    app.connect("autodoc-process-docstring", _restore, priority=900)  # after napoleon
    app.connect("autodoc-process-signature", _signature)
    app.connect("builder-inited", _without_limits)
    return {"parallel_read_safe": True}
