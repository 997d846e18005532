"""Both cameras and the transform between them, from pairs of pictures of a board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import least_squares

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.calibration.covariance import Block, covariance
from rtgs.calibration.lens import SingleFit, View, basis, fit_single, moved, project
from rtgs.maths.geometry import SE3, axis_angle_from_rotation, nearest_rotation, rotation_from_axis_angle

Array = NDArray[np.float64]
LEAST_PAIRS = 5
_FAR = 5.0  # times the usual: residuals of a picture whose corners are wrong, or of a pair that does not belong together
_SAME_TURN = np.deg2rad(10.0)
_CERTAIN = 1e-3  # probability at which pairs that do agree would look as if they did not
_MUCH = 3.0  # times the noise: from here on one rigid transform would bend the intrinsics


@dataclass(frozen=True, eq=False)
class Pair:
    """One pair of pictures with the board in both. `orders`: of the thermal points (see `Board.orders`); empty where they are certain."""

    name: str
    rgb: View
    thermal: View
    orders: tuple[NDArray[np.intp], ...] = ()


@dataclass(frozen=True, eq=False)
class Solution:
    """Both cameras and the transform between them. What there is two of stands in the order RGB, thermal.

    Attributes:
        names: of the pairs that were used.
        models: COLMAP's names.
        values: `[2, 8]`, in the order of `lens.ALL`.
        noise_px: standard deviation of a corner in each direction.
        bic: Bayesian information criterion of each model that was tried.
        rig: `[6]`, rotation vector and translation in metres of `thermal_from_rgb`.
        joint_covariance: `[22, 22]` of RGB values, thermal values and rig.
        residuals: for each camera, for each pair `[n, 2]`, pixels.
        disagreement_px: `[pairs]`, how far thermal corners are from where the RGB picture and the rig put them.
        turn_rad, shift_m: how the pairs' own transforms scatter (root mean square).
        agree: whether noise explains how the pairs' transforms differ.
        ratio: disagreement over that of noise.
        rejected: pair → reason.
    """

    names: list[str]
    models: tuple[str, str]
    values: Array
    noise_px: tuple[float, float]
    bic: tuple[dict[str, float], dict[str, float]]
    rig: Array
    joint_covariance: Array
    residuals: tuple[list[Array], list[Array]]
    disagreement_px: Array
    turn_rad: float
    shift_m: float
    agree: bool
    ratio: float
    rejected: dict[str, str] = field(default_factory=dict)


def solve(pairs: Sequence[Pair], rgb_size: tuple[int, int], thermal_size: tuple[int, int], progress: Progress) -> Solution:
    """Fit everything.

    Raises:
        RtgsError: too few pairs, or boards that no camera fits.
    """
    pairs, rejected = list(pairs), dict[str, str]()
    for _ in range(4):
        _enough(pairs, rejected)
        progress(0, 3, "each camera alone")
        single = (
            fit_single("rgb", [p.rgb for p in pairs], rgb_size),
            fit_single("thermal", [p.thermal for p in pairs], thermal_size),
        )
        bad = _bad_pictures(pairs, single)
        if not bad:
            progress(1, 3, "the transform between them")
            pairs, single, transforms = _ordered(pairs, single)
            rig, offsets = _rig_alone(pairs, single, _middle(transforms))
            bad = _bad_pairs(pairs, offsets)
        if not bad:
            break
        rejected |= bad
        pairs = [p for p in pairs if p.name not in bad]
    progress(2, 3, "all together")
    turn, shift = _scatter(transforms, rig)
    joint = _Joint(pairs, single)
    x, values, residuals = joint.fit(rig)
    apart, together = (_weighted(r, single) for r in ((single[0].residuals, single[1].residuals), residuals))
    extra, corners = 6 * (len(pairs) - 1), sum(2 * len(v.pixels) for p in pairs for v in (p.rgb, p.thermal))
    spare = corners - 12 * len(pairs) - joint.k
    f = max(0.0, together - apart) / extra / (apart / spare)
    ratio = float(np.sqrt(f))
    agree = bool(stats.f.sf(f, extra, spare) >= _CERTAIN)
    if ratio < _MUCH:
        cov, rig = joint.covariance(x), joint.rig(x)
    else:
        cov, values, residuals = _apart(pairs, single, rig), np.stack([s.values for s in single]), _residuals_of(single)
    progress(3, 3, "")
    return Solution(
        [p.name for p in pairs], (single[0].model, single[1].model), values, (single[0].noise_px, single[1].noise_px),
        (single[0].bic, single[1].bic), rig, cov, residuals, np.array([_rms(o) for o in offsets]), turn, shift, agree, ratio, rejected,
    )  # fmt: skip


def _enough(pairs: list[Pair], rejected: dict[str, str]) -> None:
    if len(pairs) < LEAST_PAIRS:
        named = "; ".join(f"{n}: {r}" for n, r in list(rejected.items())[:3])
        raise RtgsError(
            f"{len(pairs)} pairs are left to calibrate with; {LEAST_PAIRS} are needed, and 20 are usual. "
            f"{'Rejected: ' + named if named else 'Take more pictures.'}"
        )


def _rms(residuals: Array) -> float:
    """Of distances in pixels."""
    return float(np.sqrt((residuals**2).sum(axis=-1).mean()))


def _residuals_of(single: tuple[SingleFit, SingleFit]) -> tuple[list[Array], list[Array]]:
    return single[0].residuals, single[1].residuals


def _weighted(residuals: tuple[list[Array], list[Array]], single: tuple[SingleFit, SingleFit]) -> float:
    return sum(float((r**2).sum()) / s.noise_px**2 for of_one, s in zip(residuals, single, strict=True) for r in of_one)


def _bad_pictures(pairs: list[Pair], single: tuple[SingleFit, SingleFit]) -> dict[str, str]:
    bad = {}
    for which, fit in zip(("rgb", "thermal"), single, strict=True):
        rms = np.array([_rms(r) for r in fit.residuals])
        for pair, value in zip(pairs, rms, strict=True):
            if value > max(_FAR * np.median(rms), 0.05):
                bad[pair.name] = (
                    f"{which}: its corners are {value:.2f} px from any board, and the usual is {np.median(rms):.2f} px"
                )
    return bad


def _bad_pairs(pairs: list[Pair], offsets: list[Array]) -> dict[str, str]:
    rms = np.array([_rms(o) for o in offsets])
    return {
        p.name: f"its two pictures disagree with the other pairs by {r:.1f} px, and the usual is {np.median(rms):.2f} px. "
        "Are they of one instant?"
        for p, r in zip(pairs, rms, strict=True)
        if r > max(_FAR * np.median(rms), 1.0)
    }  # fmt: skip


def _se3(pose: Array) -> SE3:
    return SE3(rotation_from_axis_angle(pose[:3]), pose[3:])


def _ordered(pairs: list[Pair], single: tuple[SingleFit, SingleFit]) -> tuple[list[Pair], tuple[SingleFit, SingleFit], list[SE3]]:
    """The thermal points in the order of the RGB points: the order with which most pairs agree on the rotation between the cameras.

    Where several are as good, the one whose rotation is smallest: both cameras are about the same way up.
    """
    candidates: list[list[tuple[View, Array, SE3]]] = []
    for pair, rgb, thermal in zip(pairs, single[0].poses, single[1].poses, strict=True):
        mine = []
        for order in pair.orders or (np.arange(len(pair.thermal.points)),):
            middle = pair.thermal.points.mean(axis=0)
            turn, _ = cv2.Rodrigues(thermal[:3])
            # Points listed in another order are the board turned about its middle.
            new = View(pair.thermal.points[order], pair.thermal.pixels)
            a, b = new.points - middle, pair.thermal.points - middle
            u, _, vt = np.linalg.svd(b[:, :2].T @ a[:, :2])
            flat = np.eye(3)
            flat[:2, :2] = u @ vt
            rotation = turn @ flat
            translation = thermal[3:] + turn @ middle - rotation @ middle
            pose = np.concatenate([axis_angle_from_rotation(rotation), translation])
            mine.append((new, pose, SE3(rotation, translation) @ _se3(rgb).inverse()))
        candidates.append(mine)

    def angle(a: SE3, b: SE3) -> float:
        return float(np.linalg.norm(axis_angle_from_rotation(a.rotation @ b.rotation.T)))

    def votes(rotation: SE3) -> tuple[int, float]:
        near = sum(min(angle(c[2], rotation) for c in mine) < _SAME_TURN for mine in candidates)
        return near, -angle(rotation, SE3.identity())

    best = max((c[2] for mine in candidates for c in mine), key=votes)
    chosen = [min(mine, key=lambda c: angle(c[2], best)) for mine in candidates]
    ordered = [Pair(p.name, p.rgb, c[0], ()) for p, c in zip(pairs, chosen, strict=True)]
    s = single[1]
    thermal = SingleFit(s.model, s.values, np.stack([c[1] for c in chosen]), s.residuals, s.noise_px, s.bic)
    return ordered, (single[0], thermal), [c[2] for c in chosen]


def _middle(transforms: list[SE3]) -> Array:
    rotation = nearest_rotation(np.sum([t.rotation for t in transforms], axis=0))
    return np.concatenate([axis_angle_from_rotation(rotation), np.median([t.translation for t in transforms], axis=0)])


def _scatter(transforms: list[SE3], rig: Array) -> tuple[float, float]:
    turns = [np.linalg.norm(axis_angle_from_rotation(t.rotation @ rotation_from_axis_angle(rig[:3]).T)) for t in transforms]
    shifts = [np.linalg.norm(t.translation - rig[3:]) for t in transforms]
    return float(np.sqrt(np.mean(np.square(turns)))), float(np.sqrt(np.mean(np.square(shifts))))


def _rig_blocks(pairs: list[Pair], single: tuple[SingleFit, SingleFit], rig: Array) -> list[Block]:
    """Thermal residuals with the boards where the RGB camera sees them; derivatives by the rig. In pixels."""
    blocks = []
    for pair, pose in zip(pairs, single[0].poses, strict=True):
        in_thermal, by_rig = moved(rig, moved(pose, pair.thermal.points)[0])
        pixels, by_point, _ = project(single[1].values, in_thermal)
        blocks.append(
            Block((by_point @ by_rig).reshape(-1, 6), np.empty((2 * len(pixels), 0)), (pixels - pair.thermal.pixels).ravel())
        )
    return blocks


def _rig_alone(pairs: list[Pair], single: tuple[SingleFit, SingleFit], start: Array) -> tuple[Array, list[Array]]:
    """The rig that explains the thermal corners best where the intrinsics are those of each camera alone, and what it leaves."""
    found = least_squares(
        lambda x: np.concatenate([b.residuals for b in _rig_blocks(pairs, single, x)]),
        start,
        lambda x: np.concatenate([b.shared for b in _rig_blocks(pairs, single, x)]),
        loss="soft_l1",
        x_scale="jac",
    )
    return found.x, [b.residuals.reshape(-1, 2) for b in _rig_blocks(pairs, single, found.x)]


def _apart(pairs: list[Pair], single: tuple[SingleFit, SingleFit], rig: Array) -> Array:
    """`[22, 22]` where intrinsics come from each camera alone and the rig from the scatter of the pairs."""
    out = np.zeros((22, 22))
    for i, (fit, views) in enumerate(zip(single, ([p.rgb for p in pairs], [p.thermal for p in pairs]), strict=True)):
        moves, blocks = basis(fit.model), []
        for v, pose, r in zip(views, fit.poses, fit.residuals, strict=True):
            points, by_pose = moved(pose, v.points)
            _, by_point, by_values = project(fit.values, points)
            n = fit.noise_px
            blocks.append(
                Block((by_values @ moves / n).reshape(-1, moves.shape[1]), (by_point @ by_pose / n).reshape(-1, 6), r.ravel() / n)
            )
        out[8 * i : 8 * i + 8, 8 * i : 8 * i + 8] = moves @ covariance(blocks) @ moves.T
    out[16:, 16:] = covariance(_rig_blocks(pairs, single, rig))
    return out


class _Joint:
    """Both cameras, one rig, and for each pair one pose of the board in the RGB camera. Residuals are in standard deviations."""

    def __init__(self, pairs: list[Pair], single: tuple[SingleFit, SingleFit]) -> None:
        self._pairs, self._single = pairs, single
        self._moves = [basis(s.model) for s in single]
        self._cut = self._moves[0].shape[1]
        self.k = self._cut + self._moves[1].shape[1] + 6

    def rig(self, x: Array) -> Array:
        return x[self.k - 6 : self.k]

    def _values(self, x: Array) -> list[Array]:
        return [self._moves[0] @ x[: self._cut], self._moves[1] @ x[self._cut : self.k - 6]]

    def _blocks(self, x: Array) -> list[Block]:
        rgb_values, thermal_values = self._values(x)
        n_rgb, n_thermal = (s.noise_px for s in self._single)
        blocks = []
        for pair, pose in zip(self._pairs, x[self.k :].reshape(-1, 6), strict=True):
            points, by_pose = moved(pose, pair.rgb.points)
            pixels, by_point, by_values = project(rgb_values, points)
            seen, seen_by_pose = moved(pose, pair.thermal.points)
            in_thermal, by_rig = moved(self.rig(x), seen)
            hot, hot_by_point, hot_by_values = project(thermal_values, in_thermal)
            turn, _ = cv2.Rodrigues(self.rig(x)[:3])
            a, b = 2 * len(pixels), 2 * len(hot)
            shared, own = np.zeros((a + b, self.k)), np.zeros((a + b, 6))
            shared[:a, : self._cut] = (by_values @ self._moves[0]).reshape(a, -1) / n_rgb
            shared[a:, self._cut : self.k - 6] = (hot_by_values @ self._moves[1]).reshape(b, -1) / n_thermal
            shared[a:, self.k - 6 :] = (hot_by_point @ by_rig).reshape(b, -1) / n_thermal
            own[:a] = (by_point @ by_pose).reshape(a, 6) / n_rgb
            own[a:] = (hot_by_point @ (turn @ seen_by_pose)).reshape(b, 6) / n_thermal
            off = [((pixels - pair.rgb.pixels) / n_rgb).ravel(), ((hot - pair.thermal.pixels) / n_thermal).ravel()]
            blocks.append(Block(shared, own, np.concatenate(off)))
        return blocks

    def fit(self, rig: Array) -> tuple[Array, Array, tuple[list[Array], list[Array]]]:
        """The numbers, intrinsics `[2, 8]`, and residuals in pixels."""
        free = [s.values @ m / m.sum(axis=0) for s, m in zip(self._single, self._moves, strict=True)]
        start = np.concatenate([*free, rig, self._single[0].poses.ravel()])

        def slopes(x: Array) -> Array:
            blocks = self._blocks(x)
            rows = np.cumsum([0, *(len(b.residuals) for b in blocks)])
            out = np.zeros((rows[-1], len(x)))
            for i, b in enumerate(blocks):
                out[rows[i] : rows[i + 1], : self.k] = b.shared
                out[rows[i] : rows[i + 1], self.k + 6 * i : self.k + 6 * i + 6] = b.own
            return out

        x = least_squares(
            lambda x: np.concatenate([b.residuals for b in self._blocks(x)]),
            start,
            slopes,
            method="lm",
            x_scale="jac",
            max_nfev=100,
        ).x
        rgb, thermal = [], []
        for pair, block in zip(self._pairs, self._blocks(x), strict=True):
            both = block.residuals.reshape(-1, 2)
            rgb.append(both[: len(pair.rgb.pixels)] * self._single[0].noise_px)
            thermal.append(both[len(pair.rgb.pixels) :] * self._single[1].noise_px)
        return x, np.stack(self._values(x)), (rgb, thermal)

    def covariance(self, x: Array) -> Array:
        """`[22, 22]` of RGB values, thermal values and the rig."""
        moves = np.zeros((22, self.k))
        moves[:8, : self._cut], moves[8:16, self._cut : self.k - 6] = self._moves
        moves[16:, self.k - 6 :] = np.eye(6)
        return moves @ covariance(self._blocks(x)) @ moves.T
