"""Pieces of HTML that the panels share."""

from __future__ import annotations

import html

STYLE = """<style>
[role=tab][data-dock-tab] { padding: 0 0.5em !important; }
#webgl-software-rendering { display: none; }
</style>"""
"""For the whole page. Six tabs fit a narrow panel. viser warns of slow splats where there is no GPU, and there are none here."""


def block(content: str, *, size_px: int = 13, name: str = "") -> str:
    """HTML with the margins of the controls around it. `name`: a class to find it by."""
    kind = f' class="{name}"' if name else ""
    return f'<div{kind} style="padding:0 14px 8px;font-size:{size_px}px;line-height:1.45;overflow-wrap:anywhere">{content}</div>'


def hint(text: str) -> str:
    """What to do, or why there is nothing, in plain text."""
    return block(f'<span style="opacity:.7">{html.escape(text)}</span>')


def table(rows: list[tuple[str, str]], name: str) -> str:
    """A table of labels and values, both HTML."""
    left = '<td style="opacity:.7;padding:1px 10px 1px 0;vertical-align:top">'
    cells = "".join(f"<tr>{left}{a}</td><td style='padding:1px 0;vertical-align:top'>{b}</td></tr>" for a, b in rows)
    return block(f'<table class="{name}" style="border-collapse:collapse">{cells}</table>')
