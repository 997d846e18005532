"""What a solver of the scale is asked, and what it answers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.config import ScaleConfig
from rtgs.models import RgbModel
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.scale.bracket import Bracket, find_bracket
from rtgs.scale.comparison import COMPARISON, Comparison
from rtgs.scale.curves import LocalCurves
from rtgs.scale.progress import RenderProgress
from rtgs.scale.records import History, Minimum, Scan


@dataclass(frozen=True, eq=False)
class Problem:
    """A scene whose scale is to be found.

    Attributes:
        scene: registered pairs. model: the RGB model.
        frames: the training frames that may be used.
        bracket: the scales that the images can tell apart.
        comparison: how the global search compares pictures.
    """

    scene: Scene
    model: RgbModel
    frames: tuple[Frame, ...]
    bracket: Bracket
    config: ScaleConfig
    comparison: Comparison = COMPARISON
    progress: RenderProgress = field(default_factory=lambda: RenderProgress(None))

    @staticmethod
    def of(
        scene: Scene,
        model: RgbModel,
        config: ScaleConfig,
        comparison: Comparison = COMPARISON,
        progress: Progress | None = None,
    ) -> Problem:
        """Find the bracket, and choose `ScaleConfig.max_frames` training frames, evenly spaced.

        Raises:
            RtgsError: no training frame, no pixel that the model covers, or a rig without a baseline.
        """
        frames = usable_frames(scene, config)
        return Problem(scene, model, frames, find_bracket(scene, model), config, comparison, RenderProgress(progress))


def usable_frames(scene: Scene, config: ScaleConfig) -> tuple[Frame, ...]:
    """`ScaleConfig.max_frames` training frames, evenly spaced.

    Raises:
        RtgsError: no training frame.
    """
    train = scene.train_frames
    if not train:
        raise RtgsError("scale: the scene has no training frame (every registered frame is held out).")
    chosen = np.unique(np.linspace(0, len(train) - 1, min(config.max_frames, len(train))).round().astype(int))
    return tuple(train[i] for i in chosen)


@dataclass(frozen=True, eq=False)
class Found:
    """What a solver came to, and how.

    Attributes:
        theta: ln `sfm_per_metre`. init: `sfm_per_metre` where the descent started.
        curves: the frames' losses around the answer. closed: whether the resampled minima lie inside of these curves.
        history: the solver's steps. renders: how many pictures were rendered.
        doubt: why the images do not decide, as far as the solver has noticed; empty where it has not.
        scan, minima, disagreeing, blur_px: as in `ScaleEstimate`.
        keeps_interval: whether the interval is reported where the images do not decide, too.
    """

    theta: float
    init: float
    curves: LocalCurves
    closed: bool
    history: History
    renders: int
    doubt: str = ""
    scan: Scan | None = None
    minima: tuple[Minimum, ...] = ()
    disagreeing: tuple[str, ...] = ()
    blur_px: float = 0.0
    keeps_interval: bool = False


class Solver(Protocol):
    """A way to find the scale. `rtgs.scale.solvers.SOLVERS` lists them."""

    def solve(self, problem: Problem) -> Found:
        """Find the scale of a problem."""
