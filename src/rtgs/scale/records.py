"""What the scale stage hands on: `scale.json`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3
from rtgs.records.metres import LengthUnit, Metres
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene

Status = Literal["ok", "ambiguous", "unobservable"]


@dataclass(frozen=True)
class Scan:
    """The loss at a series of scales.

    Attributes:
        sfm_per_metre: `[S]`, rising. loss: `[S]`, mean over frames.
        std_error: `[S]`, standard error over frames of the loss *above the minimum's*. The difference is taken frame by frame: frames
            differ in the level of their loss, which says nothing about s.
        per_frame: frame name → `[S]`.
    """

    sfm_per_metre: tuple[float, ...]
    loss: tuple[float, ...]
    std_error: tuple[float, ...]
    per_frame: dict[str, tuple[float, ...]]

    @staticmethod
    def of(thetas: NDArray[np.float64], curves: NDArray[np.float64], names: Sequence[str]) -> Scan:
        """From ln s `[S]`, the frames' losses `[F, S]` and their names."""
        mean = curves.mean(axis=0)
        above = curves - curves[:, [int(np.argmin(mean))]]
        error = above.std(axis=0, ddof=1) / math.sqrt(len(curves)) if len(curves) > 1 else np.zeros_like(mean)
        per_frame = {name: tuple(curve.tolist()) for name, curve in zip(names, curves, strict=True)}
        return Scan(tuple(np.exp(thetas).tolist()), tuple(mean.tolist()), tuple(error.tolist()), per_frame)


class Step(NamedTuple):
    """One evaluation of a solver: θ = ln s, the mean loss of the frames it used, and dL/dθ there."""

    theta: float
    loss: float
    slope: float


@dataclass(frozen=True)
class History:
    """The steps of a solver in their order: the scale, the loss and dL/d ln s at each."""

    step: tuple[int, ...] = ()
    sfm_per_metre: tuple[float, ...] = ()
    loss: tuple[float, ...] = ()
    slope: tuple[float, ...] = ()

    @staticmethod
    def of(steps: Sequence[Step]) -> History:
        return History(
            tuple(range(len(steps))),
            tuple(math.exp(s.theta) for s in steps),
            tuple(s.loss for s in steps),
            tuple(s.slope for s in steps),
        )


@dataclass(frozen=True)
class Minimum:
    """Another scale at which the loss has a minimum.

    Attributes:
        loss_above: how much its loss lies above the answer's, mean over frames.
        chance: share of the frames' resamples in which it is the better of the two.
    """

    sfm_per_metre: float
    loss_above: float
    chance: float


@dataclass(frozen=True)
class Freedom:
    """One number of the calibration that was refined with the scale: what was expected of it, and what came out.

    Attributes:
        name: "rotation about x", ... unit: of mean (0 is what `rig.json` says), std and prior_std.
        decided: whether the images knew more than the calibration; if not, mean and std are hardly more than the prior's.
    """

    name: str
    unit: str
    mean: float
    std: float
    prior_std: float
    decided: bool


Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Refinement:
    """The rig as refined, which later stages use in place of the one in `rig.json`.

    Attributes:
        before: `sfm_per_metre` with the rig as `rig.json` says.
        freedoms: posterior of each refined number. correlation: `[1 + K, 1 + K]` of ln s and the freedoms, in this order.
        rgb_from_thermal: `[4, 4]`, metres. fl_x, fl_y: of the undistorted thermal images. time_offset: `Rig.time_offset`.
    """

    before: float
    freedoms: tuple[Freedom, ...]
    correlation: Matrix
    rgb_from_thermal: Matrix
    fl_x: float
    fl_y: float
    time_offset: float

    @staticmethod
    def of(before: float, freedoms: Sequence[Freedom], covariance: NDArray[np.float64], rig: Rig) -> Refinement:
        """From the scale before, the posteriors, the covariance `[1 + K, 1 + K]` of ln s and the freedoms, and the refined rig."""
        std = np.sqrt(np.diag(covariance))
        std = np.where(std > 0, std, 1.0)  # of a scale that is not decided
        return Refinement(
            before,
            tuple(freedoms),
            _matrix(covariance / np.outer(std, std)),
            _matrix(rig.rgb_from_thermal.matrix()),
            rig.thermal.fl_x,
            rig.thermal.fl_y,
            rig.time_offset,
        )

    def apply(self, scene: Scene) -> Scene:
        """The scene with its rig as refined."""
        thermal = replace(scene.rig.thermal, fl_x=self.fl_x, fl_y=self.fl_y)
        pose = SE3.from_matrix(self.rgb_from_thermal)
        rig = replace(scene.rig, thermal=thermal, rgb_from_thermal=pose, time_offset=self.time_offset, start=None)
        return replace(scene, capture=replace(scene.capture, rig=rig))


@dataclass(frozen=True)
class FoundRig:
    """A rig that was found from the capture, since `rig.json` gives none. `Refinement` has the rig itself.

    Attributes:
        baseline_seen: whether the images tell that there is a baseline; if not, both cameras are taken to stand in the same place.
        baseline_decided: whether they tell its length, within a factor of 1.65 to either side.
        baseline_sfm, baseline_std_log: its length in SfM units, and its standard deviation, relative; None where it is not seen.
        baseline_m: the length that `rig.json` gives; None: nothing about the rig tells metres.
        loss_without_baseline, loss: of the pictures (Eq. 7), without a baseline and with the one found.
        significance: of the difference, in standard errors over the frames.
        candidates: agreement of the edges at the best rotations of the search, best first, from 0 to 1.
        contrast: by how many standard errors over the frames the edges agree better than where the thermal camera is turned aside.
    """

    baseline_seen: bool
    baseline_decided: bool
    baseline_sfm: float | None
    baseline_std_log: float | None
    baseline_m: float | None
    loss_without_baseline: float
    loss: float
    significance: float
    candidates: tuple[float, ...]
    contrast: float


def _matrix(values: NDArray[np.float64]) -> Matrix:
    return tuple(tuple(row) for row in values.tolist())


@dataclass(frozen=True)
class ScaleEstimate:
    """What `scale.json` holds (through `rtgs.base.json_records`, with `metres_per_sfm` added).

    Attributes:
        sfm_per_metre: SfM units per metre (the paper's s).
        std_log: standard deviation of ln s: the scatter between frames, and the calibration's error as far as `rig.json` states it.
            None with a single frame, or where the global search finds nothing to observe.
        ci95: 95 % interval of `sfm_per_metre`; None likewise.
        status, reason: "ok", "ambiguous" (another scale fits as well) or "unobservable" (the images do not decide); why, in words.
        solver: its name in `ScaleConfig.solver`. init: where it started.
        bracket: scales that the images can tell apart.
        baseline_m: |t| of the rig; None where nothing states it. frames: those whose curves the answer and its interval are taken from.
        scan: the loss over the bracket; None where a start was given. local: the loss close to the answer; what the interval is taken
            from. history: the solver's steps.
        minima: other minima, best first.
        disagreeing: frames that place their own minimum far from the answer.
        calibration_std_log: share of `std_log` that is the calibration's; None when `rig.json` does not state any.
        renders: how many pictures were rendered.
        blur_px: by how much thermal images were found softer than renders: standard deviation of a Gaussian, in thermal pixels.
        misfit_px: by how many thermal pixels the edges miss each other in a way that a turn of the thermal camera would mend and no scale
            does; 0 where the calibration is refined, or the answer was in doubt already.
        refinement: the calibration, where it was refined with the scale or found; `refined_scene` has it.
        metres: what lengths in metres rest on; None where only these images were asked.
        calibration: how the rig was found, where `rig.json` gives none. Without a length of the baseline, 1 stands for it wherever metres
            are meant.
    """

    JSON_PROPERTIES: ClassVar[tuple[str, ...]] = ("metres_per_sfm",)

    sfm_per_metre: float
    std_log: float | None
    ci95: tuple[float, float] | None
    status: Status
    reason: str
    solver: str
    init: float
    bracket: tuple[float, float]
    baseline_m: float | None
    frames: tuple[str, ...]
    scan: Scan | None
    local: Scan
    history: History
    minima: tuple[Minimum, ...] = ()
    disagreeing: tuple[str, ...] = ()
    calibration_std_log: float | None = None
    renders: int = 0
    blur_px: float = 0.0
    misfit_px: float = 0.0
    refinement: Refinement | None = None
    metres: Metres | None = None
    calibration: FoundRig | None = None

    def __post_init__(self) -> None:
        if not 0 < self.sfm_per_metre < math.inf:
            raise RtgsError(f"sfm_per_metre is {self.sfm_per_metre:g}; it is a finite number above 0.")

    @property
    def metres_per_sfm(self) -> float | None:
        """What lengths in SfM units are multiplied by; None where nothing tells metres, and `no_metres` says why.

        It rests on all sources of metres. `sfm_per_metre` places the thermal cameras: its product with the baseline's length in `rig.json`
        is what the images show.
        """
        combined = self.metres.sfm_per_metre if self.metres else None
        if combined is not None:
            return 1.0 / combined
        return 1.0 / self.sfm_per_metre if self._baseline_counts else None

    @property
    def _baseline_counts(self) -> bool:
        """Whether the baseline gives a number of metres, be it in doubt. One that was found has to be free of doubt."""
        return self.calibration is None or self.status == "ok"

    @property
    def no_metres(self) -> str:
        """Why there are no metres, and what to add; empty where there are."""
        if self.metres_per_sfm is not None:
            return ""
        found = self.calibration
        decided = found is not None and found.baseline_decided and self.ci95 is not None
        add = 'its length as "baseline_m" in rig.json, ' if decided and self.baseline_m is None else ""
        return (
            f"nothing tells metres, so lengths are in SfM units: {self.reason.rstrip('.')}. Add {add}a known distance or a board "
            "(metres.json), or photographs with GPS."
        )

    @property
    def no_control(self) -> str:
        """Why no thermal model at `sfm_per_metre` = 1 can be a control of this one; empty where it can.

        Of a rig that was found, the baseline may have no direction, or no length in metres.
        """
        if self.calibration is None:
            return ""
        if not self.calibration.baseline_seen:
            return "the control at scale 1 is left out: the images do not tell in which direction the baseline points."
        return (
            ""
            if self.baseline_m is not None
            else "the control at scale 1 is left out: rig.json does not say how long the baseline is."
        )

    @property
    def unit_per_sfm(self) -> float:
        """What lengths in SfM units are multiplied by to be in `length_unit`."""
        return 1.0 if self.metres_per_sfm is None else self.metres_per_sfm

    @property
    def length_unit(self) -> LengthUnit:
        """Of lengths for people and for files: metres where they are known."""
        return "SfM units" if self.metres_per_sfm is None else "m"

    @property
    def metres_ci95(self) -> tuple[float, float] | None:
        """95 % interval of the SfM units per metre that lengths rest on; None where it is not known."""
        if self.metres is not None and self.metres.sfm_per_metre is not None and self.metres.rests_on != ("baseline",):
            return self.metres.ci95
        return self.ci95 if self._baseline_counts else None

    @property
    def doubt(self) -> str:
        """Why lengths in metres should not be relied on; empty where they may be, and where there are none."""
        if self.metres_per_sfm is None:
            return ""
        if self.metres is not None and self.metres.disagreement:
            return self.metres.disagreement
        rests_elsewhere = (
            self.metres is not None and self.metres.sfm_per_metre is not None and "baseline" not in self.metres.rests_on
        )
        return "" if self.status == "ok" or rests_elsewhere else self.reason

    def refined_scene(self, scene: Scene) -> Scene:
        """The scene whose rig belongs to this scale: as refined, or as it is where nothing was."""
        return scene if self.refinement is None else self.refinement.apply(scene)
