"""Ours: the scale that this package estimates, with the rig as it was refined."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from rtgs.base.progress import Progress
from rtgs.experiments.strategies.strategy import Given, Placement, Strategy


def _place(given: Given, progress: Progress) -> Placement:
    return Placement(given.estimate.refined_scene(given.scene), given.estimate.sfm_per_metre)


def _inputs(given: Given) -> Any:
    refinement = given.estimate.refinement
    return given.estimate.sfm_per_metre, None if refinement is None else asdict(refinement)


OURS = Strategy("ours", "Ours", _place, _inputs)
