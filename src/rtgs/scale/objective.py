"""The paper's objective: L(s), Eqs. 1–4 and 7, and its derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rtgs.images.filters import GRAY_WEIGHTS, downsample, downsample_mask, to_gray
from rtgs.losses.edge_loss import EdgeLoss, EdgeTarget, Products
from rtgs.losses.ngf import NgfPyramid
from rtgs.losses.ngf_fused import FusedNgf
from rtgs.maths.geometry import SE3
from rtgs.models import RgbModel
from rtgs.records.camera import INTRINSICS, Camera
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene
from rtgs.renderer import Direction, RenderSettings, render, render_with_tangents
from rtgs.scale.rig_motion import scale_direction


@dataclass(frozen=True)
class FrameLoss:
    """One frame's loss at a scale, its derivative by θ, and the Gauss–Newton curvature 2·JᵀJ of the same residuals."""

    loss: float
    slope: float
    curvature: float


@dataclass(frozen=True, eq=False)
class Objective:
    """Per-frame losses of a frozen RGB model against the thermal images, as a function of θ = ln sfm_per_metre.

    The target of a frame is prepared when it is first asked for, and kept. Apart from that, an objective never changes.

    Attributes:
        scene: rig, poses and thermal images. model: the RGB model.
        frames: which frames; training frames only. The methods take a frame by its index in here.
        edge_loss: how pictures are compared.
        reduction: pictures are compared at 1 / `reduction` of their size. They are rendered small, not rendered and shrunk.
        thermal: frame name → image `[h, w]` in [0, 1]; None: the frames' own over their common range (`scaled_thermal`).
        masks: frame name → pixels `[h, w]` where the loss counts; None: the capture's thermal mask for all.
    """

    scene: Scene
    model: RgbModel
    frames: Sequence[Frame]
    edge_loss: EdgeLoss
    reduction: int = 1
    thermal: Mapping[str, NDArray[np.float32]] | None = None
    masks: Mapping[str, NDArray[np.bool_]] | None = None
    _readable: dict[int, NgfPyramid] = field(init=False, repr=False, default_factory=dict)  # filled by `readable_target` alone
    _fused: dict[int, FusedNgf] = field(init=False, repr=False, default_factory=dict)  # filled by `_target` alone

    def loss(self, index: int, theta: float) -> float:
        """Eq. 7 for one frame."""
        return float(self.loss_over_blur(index, theta, (self.edge_loss.blur_px,))[0])

    def loss_over_blur(self, index: int, theta: float, blurs_px: Sequence[float]) -> NDArray[np.float64]:
        """Eq. 7 of one picture, rendered once and blurred by each of these in place of `EdgeLoss.blur_px`."""
        target, losses = self._target(index), []
        with torch.no_grad():
            sharp = self._sharp(index, torch.tensor(theta, dtype=torch.float64))
            for blur_px in blurs_px:
                losses.append(target.loss(replace(self.edge_loss, blur_px=blur_px).softened(sharp[None])[0]))
        return np.array(losses)

    def loss_and_slope(self, index: int, theta: float) -> tuple[float, float]:
        """Eq. 7 for one frame and its derivative by θ: in forward mode."""
        result = self.evaluate(index, theta)
        return result.loss, result.slope

    def evaluate(self, index: int, theta: float) -> FrameLoss:
        """Loss, slope and Gauss–Newton curvature from one picture and its tangent."""
        found = self._target(index).products(*self._along_scale(index, theta))
        return FrameLoss(found.loss, float(found.slope[0]), float(found.curvature[0, 0]))

    def products(
        self,
        index: int,
        camera: Camera,
        camera_from_world: SE3,
        directions: Sequence[Direction],
        *,
        curvature: bool = True,
    ) -> Products:
        """Eq. 7 for one frame seen by another thermal camera (given at full size) from another place, and its derivatives.

        Args:
            directions: ways for that camera to change, at full size; one derivative each.
            curvature: whether the Gauss–Newton matrix is wanted.

        Raises:
            RtgsError: no direction or more than eight.
        """
        small = [replace(d, **{k: getattr(d, k) / self.reduction for k in INTRINSICS}) for d in directions]
        pose = camera_from_world.to_torch(torch.float64)
        seen = self._with_tangents(camera.reduced(self.reduction), pose, small)
        return self._target(index).products(*seen, curvature=curvature)

    def loss_seen_by(self, index: int, camera: Camera, camera_from_world: SE3) -> float:
        """Eq. 7 for one frame seen by another thermal camera (given at full size) from another place."""
        with torch.no_grad():
            sharp = self._drawn(camera.reduced(self.reduction), camera_from_world.to_torch(torch.float64))
            return self._target(index).loss(self.edge_loss.softened(sharp[None])[0])

    def picture(self, index: int, theta: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Gray picture `[h, w]` and its derivative by θ, for other losses than Eq. 7."""
        gray, rates = self._along_scale(index, theta)
        return gray.numpy(), rates[0].numpy()

    def gray(self, index: int, theta: Tensor) -> Tensor:
        """Î_i^gray(s) `[h, w]` (Eqs. 1–3), blurred as the loss asks; differentiable in θ (a float64 scalar)."""
        return self.edge_loss.softened(self._sharp(index, theta)[None])[0]

    # --- the target ---

    @property
    def _dtype(self) -> torch.dtype:
        return self.model.gaussians.means.dtype

    @property
    def _compiled(self) -> bool:
        """Whether the compiled loss can be used: on float32 pictures."""
        return self._dtype == torch.float32

    def _target(self, index: int) -> EdgeTarget:
        if not self._compiled:
            return self.readable_target(index)
        if index not in self._fused:  # the readable one, in float64, takes three times the memory and is not needed any more
            self._fused[index] = FusedNgf.of(self._readable_target(index))
        return self._fused[index]

    def readable_target(self, index: int) -> NgfPyramid:
        """Eq. 7 against one frame's thermal image in PyTorch, which autograd can differentiate."""
        if index not in self._readable:
            self._readable[index] = self._readable_target(index)
        return self._readable[index]

    def _readable_target(self, index: int) -> NgfPyramid:
        frame, valid = self.frames[index], self.scene.capture.thermal_mask
        # In float64, 1 − ‖n‖² is exact for the fused kernels; without them the loss computes in the model's own type.
        image = torch.from_numpy(self._images[frame.name]).to(torch.float64 if self._compiled else self._dtype)
        mask = valid if self.masks is None else self.masks[frame.name] & valid
        small_mask = downsample_mask(torch.from_numpy(np.ascontiguousarray(mask)), self.reduction)
        return NgfPyramid.of(downsample(image, self.reduction), small_mask, self.edge_loss)

    @cached_property
    def _images(self) -> Mapping[str, NDArray[np.float32]]:
        if self.thermal is not None:
            return self.thermal
        return scaled_thermal({f.name: f.thermal for f in self.frames}, self.scene.capture.thermal_mask)

    # --- the picture ---

    @cached_property
    def _camera(self) -> Camera:
        return self.scene.rig.thermal.reduced(self.reduction)

    @cached_property
    def _settings(self) -> RenderSettings:
        return replace(self.model.settings, with_depth=False, channel_weights=GRAY_WEIGHTS)

    @cached_property
    def _background(self) -> Tensor:
        return to_gray(self.model.background).to(self._dtype)

    @cached_property
    def _world_from_rgb(self) -> list[SE3]:
        return [self.scene.world_from_rgb_at_thermal(f.name).to_torch(torch.float64) for f in self.frames]

    @cached_property
    def _rgb_from_thermal(self) -> SE3:
        return self.scene.rig.rgb_from_thermal.to_torch(torch.float64)

    def _pose(self, index: int, theta: Tensor) -> SE3:
        per_metre = self.scene.world_per_metre(torch.exp(theta))
        return (self._world_from_rgb[index] @ self._rgb_from_thermal.with_baseline_scaled(per_metre)).inverse()  # Eq. 1

    def _sharp(self, index: int, theta: Tensor) -> Tensor:
        return self._drawn(self._camera, self._pose(index, theta))

    def _drawn(self, camera: Camera, camera_from_world: SE3) -> Tensor:
        view = render(self.model.gaussians, camera, camera_from_world, settings=self._settings)
        return view.color[..., 0] + (1.0 - view.alpha) * self._background

    def _along_scale(self, index: int, theta: float) -> tuple[Tensor, Tensor]:
        """Gray picture `[h, w]` and its tangent along θ, `[1, h, w]`."""
        pose = self._pose(index, torch.tensor(theta, dtype=torch.float64))
        return self._with_tangents(self._camera, pose, [scale_direction(self.scene, theta)])

    def _with_tangents(self, camera: Camera, pose: SE3, directions: Sequence[Direction]) -> tuple[Tensor, Tensor]:
        """Gray picture `[h, w]` and its tangents `[K, h, w]`."""
        view, tangents = render_with_tangents(self.model.gaussians, camera, pose, directions, settings=self._settings)
        gray = view.color[..., 0] + (1.0 - view.alpha) * self._background
        rates = tangents.over(self._background[None])[..., 0]
        if not self.edge_loss.blur_px:
            return gray, rates
        both = self.edge_loss.softened(torch.cat([gray[None], rates]))
        return both[0], both[1:]


def scaled_thermal(images: Mapping[str, NDArray[np.float32]], valid: NDArray[np.bool_]) -> dict[str, NDArray[np.float32]]:
    """Thermal images `[h, w]` by frame name, brought to [0, 1] over the common range of all their valid pixels; 0 elsewhere."""
    values = np.concatenate([image[valid] for image in images.values()])
    lo, hi = float(values.min()), float(values.max())
    span = hi - lo if hi > lo else 1.0
    return {name: np.where(valid, (image - lo) / span, 0.0).astype(np.float32) for name, image in images.items()}
