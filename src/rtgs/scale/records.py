"""What the scale stage hands on: `scale.json`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rtgs.maths.geometry import SE3
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene

Status = Literal["ok", "ambiguous", "unobservable"]


@dataclass(frozen=True)
class Scan:
    """The loss over the bracket.

    Attributes:
        sfm_per_metre: `[S]`, rising. loss: `[S]`, mean over frames.
        std_error: `[S]`, standard error over frames of the loss *above the minimum's* (paired: frames differ in level, which says
            nothing about s).
        per_frame: frame name → `[S]`.
    """

    sfm_per_metre: list[float]
    loss: list[float]
    std_error: list[float]
    per_frame: dict[str, list[float]]

    @staticmethod
    def of(thetas: NDArray[np.float64], curves: NDArray[np.float64], names: Sequence[str]) -> Scan:
        """From ln s `[S]` and per-frame losses `[F, S]`."""
        mean = curves.mean(axis=0)
        above = curves - curves[:, [int(np.argmin(mean))]]
        error = above.std(axis=0, ddof=1) / math.sqrt(len(curves)) if len(curves) > 1 else np.zeros_like(mean)
        per_frame = {n: c.tolist() for n, c in zip(names, curves, strict=True)}
        return Scan(np.exp(thetas).tolist(), mean.tolist(), error.tolist(), per_frame)


@dataclass(frozen=True)
class History:
    """One entry a step: the scale before it, the loss and dL/d ln s there."""

    step: list[int]
    sfm_per_metre: list[float]
    loss: list[float]
    slope: list[float]

    def add(self, theta: float, loss: float, slope: float) -> None:
        self.step.append(len(self.step))
        self.sfm_per_metre.append(math.exp(theta))
        self.loss.append(loss)
        self.slope.append(slope)


@dataclass(frozen=True)
class Minimum:
    """Another scale at which the edges meet.

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


@dataclass(frozen=True)
class Refinement:
    """The rig as refined, which later stages use in place of the one in `rig.json`.

    Attributes:
        before: `sfm_per_metre` with the rig as `rig.json` says.
        freedoms: posterior of each. correlation: `[1 + K, 1 + K]` of ln s and the freedoms, in this order.
        rgb_from_thermal: `[4, 4]`, metres. fl_x, fl_y: of the undistorted thermal images. time_offset: `Rig.time_offset`.
    """

    before: float
    freedoms: list[Freedom]
    correlation: list[list[float]]
    rgb_from_thermal: list[list[float]]
    fl_x: float
    fl_y: float
    time_offset: float

    @staticmethod
    def of(before: float, freedoms: list[Freedom], covariance: NDArray[np.float64], rig: Rig) -> Refinement:
        std = np.sqrt(np.diag(covariance))
        return Refinement(
            before,
            freedoms,
            (covariance / np.outer(std, std)).tolist(),
            rig.rgb_from_thermal.matrix().tolist(),
            rig.thermal.fl_x,
            rig.thermal.fl_y,
            rig.time_offset,
        )

    @property
    def undecided(self) -> list[str]:
        return [f.name for f in self.freedoms if not f.decided]

    def apply(self, scene: Scene) -> Scene:
        """The scene with its rig as refined."""
        thermal = replace(scene.rig.thermal, fl_x=self.fl_x, fl_y=self.fl_y)
        pose = SE3.from_matrix(self.rgb_from_thermal)
        rig = replace(scene.rig, thermal=thermal, rgb_from_thermal=pose, time_offset=self.time_offset)
        return replace(scene, capture=replace(scene.capture, rig=rig))

    @staticmethod
    def from_json(data: dict[str, Any]) -> Refinement:
        return Refinement(**{**data, "freedoms": [Freedom(**f) for f in data["freedoms"]]})


@dataclass(frozen=True)
class ScaleEstimate:
    """What `scale.json` holds.

    Attributes:
        sfm_per_metre: SfM units per metre (the paper's s).
        std_log: standard deviation of ln s: the scatter between frames, and the calibration's error as far as `rig.json` states it.
            None with a single frame, or where the global search finds nothing to observe.
        ci95: 95 % interval of `sfm_per_metre`; None likewise.
        status, reason: "ok", "ambiguous" (another scale fits as well) or "unobservable" (the images do not decide); why, in words.
        init: where the refinement started. bracket: scales the images can tell apart.
        baseline_m: |t| of the rig. frames: those whose curves decide.
        local: the loss close to the answer; what the interval is taken from.
        minima: other minima of the scan, refined, best first.
        disagreeing: frames that place their own minimum far from the answer.
        calibration_std_log: share of `std_log` that is the calibration's; None when `rig.json` does not state any.
        renders: how many pictures were drawn.
        blur_px: by how much thermal images were found softer than renders: standard deviation of a Gaussian, in thermal pixels.
        refinement: the calibration, where it was refined with the scale; `refined_scene` has it.
    """

    sfm_per_metre: float
    std_log: float | None
    ci95: tuple[float, float] | None
    status: Status
    reason: str
    solver: str
    init: float
    bracket: tuple[float, float]
    baseline_m: float
    frames: list[str]
    scan: Scan | None
    local: Scan
    history: History
    minima: list[Minimum] = field(default_factory=list)
    disagreeing: list[str] = field(default_factory=list)
    calibration_std_log: float | None = None
    renders: int = 0
    blur_px: float = 0.0
    refinement: Refinement | None = None

    @property
    def metres_per_sfm(self) -> float:
        return 1.0 / self.sfm_per_metre

    def refined_scene(self, scene: Scene) -> Scene:
        """The scene whose rig belongs to this scale: as refined, or as it is where nothing was."""
        return scene if self.refinement is None else self.refinement.apply(scene)

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "metres_per_sfm": self.metres_per_sfm}

    @staticmethod
    def from_json(data: dict[str, Any]) -> ScaleEstimate:
        values = {k: v for k, v in data.items() if k != "metres_per_sfm"}
        values["bracket"] = tuple(data["bracket"])
        values["ci95"] = tuple(data["ci95"]) if data["ci95"] else None
        values["scan"] = Scan(**data["scan"]) if data["scan"] else None
        values["local"] = Scan(**data["local"])
        values["history"] = History(**data["history"])
        values["minima"] = [Minimum(**m) for m in data.get("minima", [])]
        values["refinement"] = Refinement.from_json(data["refinement"]) if data.get("refinement") else None
        return ScaleEstimate(**values)


class Counter:
    """Counts renders for a progress bar. `plan` says how many are still to come, as far as is known."""

    def __init__(self, progress: Any) -> None:
        self.done, self.total, self.progress = 0, 0, progress

    def plan(self, remaining: int) -> None:
        self.total = self.done + remaining

    def __call__(self, text: str) -> None:
        self.done += 1
        if self.progress is not None:
            self.progress(self.done, max(self.total, self.done), text)
