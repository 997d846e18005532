"""The paper's objective: L(s), Eqs. 1–4 and 7, and its derivative by ln s."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.images.filters import GRAY_WEIGHTS, SOBEL, blurred, downsample, downsample_mask, to_gray
from rtgs.losses.ngf import NgfPyramid
from rtgs.losses.ngf_fused import FusedNgf, Products
from rtgs.maths.geometry import SE3
from rtgs.records.camera import Camera
from rtgs.records.capture import Frame
from rtgs.records.gaussians import Gaussians
from rtgs.records.rig import Rig
from rtgs.records.scene import Scene
from rtgs.renderer import Direction, RenderSettings, render, render_with_tangents


@dataclass(frozen=True)
class Evaluation:
    """One frame's loss at a scale, its derivative by θ, and the Gauss–Newton curvature 2·JᵀJ of the same residuals."""

    loss: float
    slope: float
    curvature: float


class Objective:
    """Per-frame losses of a frozen RGB model against the thermal images, as a function of θ = ln sfm_per_metre.

    Args:
        scene: rig, poses and thermal images.
        gaussians, background, settings: the RGB model.
        frames: which frames; training frames only.
        level_weights: of Eq. 7, beginning with the level of the pictures compared.
        epsilon: of Eq. 5, one for all levels or one a level. render_epsilon: the render's, where it is not the thermal image's.
        per_edge, across: as in `NgfPyramid.of`.
        blur_px: standard deviation of a Gaussian that renders are blurred by, in pixels of the full size: what the thermal lens does.
        reduction: compare pictures reduced by this factor: rendered small, not rendered and shrunk.
        thermal: frame name → image `[h, w]` in [0, 1]; None: the frames' own over their common range.
        masks: frame name → pixels `[h, w]` where the loss counts; None: the capture's thermal mask for all.
    """

    def __init__(
        self,
        scene: Scene,
        gaussians: Gaussians,
        background: Tensor,
        settings: RenderSettings,
        frames: Sequence[Frame],
        *,
        level_weights: tuple[float, ...],
        epsilon: float | tuple[float, ...],
        render_epsilon: float | tuple[float, ...] | None = None,
        per_edge: bool = False,
        across: tuple[float, float] = SOBEL,
        blur_px: float = 0.0,
        reduction: int = 1,
        thermal: Mapping[str, NDArray[np.float32]] | None = None,
        masks: Mapping[str, NDArray[np.bool_]] | None = None,
    ) -> None:
        self.frames = tuple(frames)
        self.renders = 0
        self._scene = scene
        self._gaussians = gaussians
        self._dtype = gaussians.means.dtype
        self._background = to_gray(background).to(self._dtype)
        self._settings = replace(settings, with_depth=False, channel_weights=GRAY_WEIGHTS)
        self._reduction, self._sigma = reduction, blur_px / reduction
        self._camera: Camera = scene.rig.thermal.reduced(reduction)
        self._rgb_from_thermal = scene.rig.rgb_from_thermal.to_torch(torch.float64)
        self._world_from_rgb = [scene.world_from_rgb_at_thermal(f.name).to_torch(torch.float64) for f in frames]
        valid = scene.capture.thermal_mask
        whole = downsample_mask(torch.from_numpy(np.ascontiguousarray(valid)), reduction)
        if thermal is None:
            lo, hi = thermal_range([f.thermal[valid] for f in frames], 0.0)
            images = [np.where(valid, (f.thermal - lo) / (hi - lo), 0.0) for f in frames]
        else:
            images = [thermal[f.name] for f in frames]
        # A target in float64 keeps 1 − ‖n‖² exact for the fused kernels; the torch path computes in the model's own type.
        self._is_fused = self._dtype == torch.float32 and gaussians.means.device.type == "cpu"
        self._level_weights, self._epsilons = level_weights, (epsilon, render_epsilon)
        self._per_edge, self._across = per_edge, across
        self._images, self._masks = images, [whole] * len(frames)
        if masks is not None:
            self._masks = [downsample_mask(torch.from_numpy(masks[f.name] & valid), reduction) for f in frames]
        self._pyramids: dict[int, NgfPyramid] = {}
        self._fused: dict[int, FusedNgf] = {}

    def _pyramid(self, index: int) -> NgfPyramid:
        """The frame's target, prepared when it is first asked for: a search looks at many frames in one size only."""
        if index not in self._pyramids:
            target = torch.from_numpy(self._images[index]).to(torch.float64 if self._is_fused else self._dtype)
            self._pyramids[index] = NgfPyramid.of(
                downsample(target, self._reduction),
                self._masks[index],
                level_weights=self._level_weights,
                epsilon=self._epsilons[0],
                render_epsilon=self._epsilons[1],
                per_edge=self._per_edge,
                across=self._across,
            )
        return self._pyramids[index]

    def _fused_ngf(self, index: int) -> FusedNgf:
        if index not in self._fused:
            self._fused[index] = FusedNgf.of(self._pyramid(index))
        return self._fused[index]

    def gray(self, index: int, theta: Tensor) -> Tensor:
        """Î_i^gray(s) `[h, w]` (Eqs. 1–3), differentiable in θ (a float64 scalar)."""
        self.renders += 1
        view = render(self._gaussians, self._camera, self._pose(index, theta), settings=self._settings)
        gray = view.color[..., 0] + (1.0 - view.alpha) * self._background
        return blurred(gray[None], self._sigma)[0] if self._sigma else gray

    def loss(self, index: int, theta: float) -> float:
        """Eq. 7 for one frame."""
        with torch.no_grad():
            gray = self.gray(index, torch.tensor(theta, dtype=torch.float64))
            return self._fused_ngf(index).loss(gray.numpy()) if self._is_fused else float(self._pyramid(index)(gray))

    def loss_over_blur(self, index: int, theta: float, sigmas: Sequence[float]) -> NDArray[np.float64]:
        """Eq. 7 of one picture, drawn once and blurred by each of these, in pixels of its own size."""
        with torch.no_grad():
            gray = self.gray(index, torch.tensor(theta, dtype=torch.float64))
            pictures = [blurred(gray[None], sigma)[0] if sigma else gray for sigma in sigmas]
        fused = self._is_fused
        return np.array([self._fused_ngf(index).loss(p.numpy()) if fused else float(self._pyramid(index)(p)) for p in pictures])

    def loss_and_slope(self, index: int, theta: float) -> tuple[float, float]:
        """Eq. 7 for one frame and its derivative by θ: in forward mode where the back end has it."""
        if self._settings.backend == "cuda":
            return self.loss_and_slope_in_reverse(index, theta)
        result = self.evaluate(index, theta)
        return result.loss, result.slope

    def loss_and_slope_in_reverse(self, index: int, theta: float) -> tuple[float, float]:
        """The same two numbers through autograd, the renderer and the pose."""
        t = torch.tensor(theta, dtype=torch.float64, requires_grad=True)
        loss = self._pyramid(index).to(self._dtype)(self.gray(index, t))
        if not loss.requires_grad:
            return loss.item(), 0.0
        loss.backward()
        return loss.item(), t.grad.item() if t.grad is not None else 0.0

    def evaluate(self, index: int, theta: float) -> Evaluation:
        """Loss, slope and Gauss–Newton curvature from one picture and its tangent.

        Raises:
            RtgsError: the "cuda" back end, which has no forward mode.
        """
        gray, rates = self._along(index, theta, [self._scale_direction(theta)])
        if self._is_fused:
            products = self._fused_ngf(index).products(gray.numpy(), rates.numpy())
            return Evaluation(products.loss, float(products.slope[0]), float(products.curvature[0, 0]))
        loss, slope = along(self._pyramid(index), gray, rates[0])
        _, change = along(self._pyramid(index).residuals, gray, rates[0])
        return Evaluation(float(loss), float(slope), 2.0 * float(change @ change))

    def picture(self, index: int, theta: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Gray picture `[h, w]` and its derivative by θ, for other losses than Eq. 7."""
        gray, rates = self._along(index, theta, [self._scale_direction(theta)])
        return gray.numpy(), rates[0].numpy()

    def curvatures(self, index: int, theta: float, changes: Sequence[Callable[[Rig, float], Rig]]) -> NDArray[np.float64]:
        """`[1 + K, 1 + K]`: the Gauss–Newton matrix of θ and of K ways in which the rig may be off (full size only).

        Raises:
            RtgsError: more than seven changes.
        """
        name, step = self.frames[index].name, 1e-6
        pose, s = self._scene.thermal_from_world(name, math.exp(theta)), math.exp(theta)
        ways = [self._scale_direction(theta)]
        for change in changes:
            ends = [replace(self._scene.capture, rig=change(self._scene.rig, e)) for e in (-step, step)]
            before, after = (replace(self._scene, capture=c).thermal_from_world(name, s) for c in ends)
            derivative = SE3(*((b - a) / (2 * step) for a, b in zip(_parts(before), _parts(after), strict=True)))
            lens = {k: (getattr(ends[1].rig.thermal, k) - getattr(ends[0].rig.thermal, k)) / (2 * step) for k in ("fl_x", "fl_y")}
            ways.append(replace(Direction.between(derivative, pose), **lens))
        gray, rates = self._along(index, theta, ways)
        if self._is_fused:
            return self._fused_ngf(index).products(gray.numpy(), np.ascontiguousarray(rates.numpy())).curvature
        jacobian = torch.stack([along(self._pyramid(index).residuals, gray, rate)[1] for rate in rates])
        return (2.0 * jacobian @ jacobian.T).numpy()

    def products_from(self, index: int, camera: Camera, camera_from_world: SE3, ways: Sequence[Direction]) -> Products:
        """Eq. 7 for one frame, its thermal camera (at full size) being this one and standing there; derivatives along ways for it to
        change, and their Gauss–Newton matrix.

        Raises:
            RtgsError: no way or more than eight; the "cuda" back end, which has no forward mode.
        """
        self.renders += 1
        lens = ("fl_x", "fl_y", "cx", "cy")
        small = [replace(way, **{k: getattr(way, k) / self._reduction for k in lens}) for way in ways]
        pose = camera_from_world.to_torch(torch.float64)
        camera = camera.reduced(self._reduction)
        gray, rates = self._drawn(camera, pose, small)
        if self._is_fused:
            return self._fused_ngf(index).products(gray.numpy(), np.ascontiguousarray(rates.numpy()))
        pyramid = self._pyramid(index)
        derivatives = [along(pyramid, gray, rate) for rate in rates]
        jacobian = torch.stack([along(pyramid.residuals, gray, rate)[1] for rate in rates])
        slope = np.array([float(d[1]) for d in derivatives])
        return Products(float(derivatives[0][0]), slope, (2.0 * jacobian @ jacobian.T).numpy())

    def _along(self, index: int, theta: float, ways: Sequence[Direction]) -> tuple[Tensor, Tensor]:
        """Gray picture `[h, w]` and its tangents `[K, h, w]`."""
        self.renders += 1
        pose = self._pose(index, torch.tensor(theta, dtype=torch.float64))
        return self._drawn(self._camera, pose, ways)

    def _drawn(self, camera: Camera, pose: SE3, ways: Sequence[Direction]) -> tuple[Tensor, Tensor]:
        view, tangents = render_with_tangents(self._gaussians, camera, pose, ways, settings=self._settings)
        gray = view.color[..., 0] + (1.0 - view.alpha) * self._background
        rates = tangents.over(self._background[None])[..., 0]
        if not self._sigma:
            return gray, rates
        both = blurred(torch.cat([gray[None], rates]), self._sigma)
        return both[0], both[1:]

    def _scale_direction(self, theta: float) -> Direction:
        # x_thermal = Rᵀ(x_rgb − s·t), so ∂x_thermal/∂ln s = −s·Rᵀt.
        x, y, z = (-math.exp(theta) * (self._rgb_from_thermal.rotation.T @ self._rgb_from_thermal.translation)).tolist()
        return Direction(translation=(x, y, z))

    def _pose(self, index: int, theta: Tensor) -> SE3:
        return (self._world_from_rgb[index] @ self._rgb_from_thermal.with_baseline_scaled(torch.exp(theta))).inverse()  # Eq. 1


def _parts(pose: SE3) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return pose.rotation, pose.translation


def along(function: Callable[[Tensor], Tensor], at: Tensor, way: Tensor) -> tuple[Tensor, Tensor]:
    """The function at a point, and its derivative along one way."""
    value, rate = torch.func.jvp(function, (at,), (way,))  # type: ignore[misc]
    return value, rate


def thermal_range(images: Sequence[np.ndarray], percentile: float) -> tuple[float, float]:
    """(lo, hi): the `percentile` and 100 − `percentile` of all pixels together; hi > lo always."""
    values = np.concatenate([np.asarray(image).ravel() for image in images])
    lo, hi = (float(v) for v in np.percentile(values, [percentile, 100.0 - percentile]))
    return lo, hi if hi > lo else lo + 1.0
