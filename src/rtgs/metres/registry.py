"""The sources of metres, in the order in which results show them."""

from __future__ import annotations

from rtgs.metres import baseline, board, distances, gps, laser
from rtgs.metres.evidence import Source

SOURCES: tuple[Source, ...] = (baseline.SOURCE, gps.SOURCE, distances.SOURCE, board.SOURCE, laser.SOURCE)
