"""Metres from several sources: each gives SfM units per metre with a standard deviation, and they are combined when they agree."""

from rtgs.metres.find import Found, find_metres

__all__ = ["Found", "find_metres"]
