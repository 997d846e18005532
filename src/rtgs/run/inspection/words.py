"""The text of the report, from one catalogue. Another language is another file beside `english.json`."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

LANGUAGE = "english"


class Words:
    """A catalogue: key → text, with `{names}` for values."""

    def __init__(self, texts: Mapping[str, str]) -> None:
        self.texts = texts

    @staticmethod
    @cache
    def load(language: str = LANGUAGE) -> Words:
        """The catalogue of a language, from this package."""
        return Words(json.loads((files("rtgs.run.inspection") / f"{language}.json").read_text(encoding="utf-8")))

    def __call__(self, key: str, **values: object) -> str:
        """The text with the values in it, escaped for HTML. A key that the catalogue lacks is a defect (KeyError)."""
        return html.escape(self.plain(key, **values))

    def plain(self, key: str, **values: object) -> str:
        """The same, not escaped."""
        return self.texts[key].format(**values)
