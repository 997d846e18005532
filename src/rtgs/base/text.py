"""Words that people read."""

from __future__ import annotations


def first_upper(sentence: str) -> str:
    """With a capital first letter."""
    return sentence[:1].upper() + sentence[1:]
