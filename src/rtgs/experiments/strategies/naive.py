"""Naive: the scale is ignored. One SfM unit is taken for one metre."""

from __future__ import annotations

from rtgs.base.progress import Progress
from rtgs.experiments.strategies.strategy import Given, Placement, Strategy


def _place(given: Given, progress: Progress) -> Placement:
    return Placement(given.scene, 1.0)


NAIVE = Strategy("naive", "Naive", _place, lambda given: None)
