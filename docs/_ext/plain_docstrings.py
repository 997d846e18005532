"""Docstrings in this package are plain text with `code` and *titles*; Sphinx expects reStructuredText. This turns one into the other.

Code in single backticks becomes literal text, formulas set apart by indentation become literal blocks, and characters that
reStructuredText would take for markup are escaped.
"""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

_SECTIONS = ("Args:", "Returns:", "Raises:", "Attributes:", "Yields:")
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
            out.append(line if not line.strip() else plain(line))
    return out


def _convert(app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]) -> None:
    lines[:] = converted(lines)


def setup(app: Sphinx) -> dict[str, Any]:
    app.connect("autodoc-process-docstring", _convert, priority=100)  # before napoleon reads the sections
    return {"parallel_read_safe": True}
