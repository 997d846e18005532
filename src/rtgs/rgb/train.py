"""Stage 1: train the RGB model, the anchor that the scale is found against."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numba as nb
import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from rtgs.base.errors import RtgsError
from rtgs.base.files import write_whole
from rtgs.base.progress import Progress
from rtgs.base.threads import in_order
from rtgs.config import RgbConfig
from rtgs.io.ply import read_ply
from rtgs.losses.photometric import photometric
from rtgs.losses.ssim import whole_windows
from rtgs.maths import sh
from rtgs.maths.adam import Adam
from rtgs.metrics.basic import psnr
from rtgs.models import RgbModel
from rtgs.records.capture import Frame
from rtgs.records.gaussians import Gaussians
from rtgs.records.scene import Scene
from rtgs.renderer import RenderSettings, render
from rtgs.renderer.reference import rotation_from_quats
from rtgs.rgb.densify import ScreenGradients, budget, densify, is_round, target_count

# 3DGS's rates are meant for so many steps. Fewer have to be larger: the square root keeps a random walk's reach. Sizes need it most.
RATES_STEPS = 30_000
MOST_PACE = 8.0
SETTLE_FROM, SETTLE_TO = 0.7, 0.05  # from this share of the steps on, all rates fall to this share
NEAR_FRACTION = 0.01  # near plane as a share of the scene's extent, so that any SfM unit gives the same picture


def fit_rgb(
    scene: Scene,
    config: RgbConfig | None = None,
    *,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
    snapshot: Callable[[int, RgbModel], None] | None = None,
) -> RgbModel:
    """Train 3D Gaussians on the scene's training frames (Kerbl et al. 2023).

    Args:
        scene: at least one training frame.
        checkpoint: where to keep the state while training; a file that is there is continued, bit for bit.
        progress: called with (step, steps, text).
        snapshot: called with (step, model) about twenty times while the model grows. The model is a copy.

    Raises:
        RtgsError: no training frame, cameras all in one point, or a checkpoint of another configuration.
    """
    config = config or RgbConfig()
    if not scene.train_frames:
        raise RtgsError("fit_rgb: the scene has no training frame (every registered frame is held out).")
    if scene.extent == 0.0:
        raise RtgsError("fit_rgb: all frames were taken from one point; depth needs cameras that stand apart.")
    training = _Training(scene, config)
    if checkpoint is not None and checkpoint.exists():
        training.restore(checkpoint)
    steps = training.steps
    every = max(steps // 20, 1)
    while training.step < steps:
        training.advance()
        step = training.step
        if step % every == 0 or step == steps:
            training.record()
            if checkpoint is not None and step < steps:
                training.save(checkpoint)
            if snapshot is not None:
                snapshot(step, training.copied_model())
        if progress is not None:
            progress(step, steps, training.summary())
    return training.model()


def model_from_ply(path: Path, extent: float) -> RgbModel:
    """A trained 3DGS model instead of our own, over a black background.

    Args:
        extent: of the scene it belongs to (`Scene.extent`), for the near plane.

    Raises:
        RtgsError: unreadable, or a one-channel thermal model.
    """
    gaussians = read_ply(path)
    if gaussians.channels != 3:
        raise RtgsError(f"{path}: a thermal model of one channel; an RGB model is needed.")
    return RgbModel(gaussians, torch.zeros(3), RenderSettings(near_plane=NEAR_FRACTION * extent))


def initial_gaussians(xyz: np.ndarray, rgb: np.ndarray, sh_degree: int) -> Gaussians:
    """One Gaussian a point: its size is the mean distance to its three nearest neighbours, its opacity 0.1.

    Args:
        xyz: `[P, 3]` world units; rgb: `[P, 3]` in [0, 1].
    """
    distances, _ = cKDTree(xyz).query(xyz, k=min(4, len(xyz)))
    size = np.sqrt((np.atleast_2d(distances)[:, 1:] ** 2).mean(axis=1)) if len(xyz) > 1 else np.ones(1)
    size = np.clip(size, np.percentile(size, 1), np.percentile(size, 99)).clip(min=1e-12)
    n = len(xyz)
    coefficients = torch.zeros(n, sh.coefficients(sh_degree), 3)
    coefficients[:, 0] = (torch.as_tensor(rgb, dtype=torch.float32) - 0.5) / sh.C0
    quats = torch.zeros(n, 4)
    quats[:, 0] = 1.0
    return Gaussians(
        torch.as_tensor(xyz, dtype=torch.float32),
        quats,
        torch.as_tensor(np.log(size), dtype=torch.float32)[:, None].repeat(1, 3),
        torch.full((n,), math.log(0.1 / 0.9)),
        coefficients,
    )


def _border(frame: Frame) -> np.ndarray:
    """`[P, 3]`: the outermost pixels of an RGB image, its corners twice."""
    image = frame.rgb
    return np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]])


def _random_points(scene: Scene, n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Uniform in what the cameras look at: frusta cut off at twice the scene's extent."""
    rng = np.random.default_rng(seed)
    camera, frames = scene.rig.rgb, scene.train_frames
    which = rng.integers(len(frames), size=n)
    # Uniform in the frustum's volume: depth by the cube root.
    depth = 2.0 * max(scene.extent, 1e-9) * rng.uniform(0.05**3, 1.0, n) ** (1 / 3)
    rays = np.stack(
        [
            (rng.uniform(0, camera.width, n) - camera.cx) / camera.fl_x,
            (rng.uniform(0, camera.height, n) - camera.cy) / camera.fl_y,
            np.ones(n),
        ],
        axis=1,
    )
    in_camera = rays * depth[:, None]
    xyz = np.empty((n, 3))
    for k, frame in enumerate(frames):
        chosen = which == k
        xyz[chosen] = scene.world_from_rgb[frame.name].apply(in_camera[chosen])
    return xyz, rng.uniform(0.2, 0.8, (n, 3))


class _Training:
    """All the state of a run, so that it can be saved and continued."""

    def __init__(self, scene: Scene, config: RgbConfig) -> None:
        config = config.resolved()
        assert config.steps is not None and config.sh_degree is not None
        self.scene, self.config = scene, config
        self.step, self.steps, self.sh_degree = 0, config.steps, config.sh_degree
        self.generator = torch.Generator().manual_seed(config.seed)
        self.settings = RenderSettings(near_plane=NEAR_FRACTION * scene.extent, antialiased=config.antialiased)
        self.budget = budget(config.densify, scene.rig.rgb.width * scene.rig.rgb.height, len(scene.points))
        if len(scene.points):
            xyz, rgb = scene.points.xyz, scene.points.rgb
            if len(xyz) > self.budget:
                chosen = np.random.default_rng(config.seed).permutation(len(xyz))[: self.budget]
                xyz, rgb = xyz[chosen], rgb[chosen]
        else:
            xyz, rgb = _random_points(scene, min(config.random_points, self.budget), config.seed)
        start = initial_gaussians(xyz, rgb, 0)  # bands join as they are switched on
        self.initial = len(start)
        self.optimizer = Adam(start.tensors(), self._rates(0))
        frame_parameters = {
            "background": self._initial_background(),
            "gain": torch.ones(len(scene.train_frames), 3),
            "offset": torch.zeros(len(scene.train_frames), 3),
        }
        exposure = 1e-3 if config.exposure else 0.0
        background = 2e-3 if config.background == "learned" else 0.0
        self.frame_optimizer = Adam(frame_parameters, {"background": background, "gain": exposure, "offset": exposure})
        self.gradients = ScreenGradients(self.initial)
        self.order: list[int] = []
        self.history: dict[str, list[float]] = {"step": [], "gaussians": [], "held_out_psnr": []}
        self._images: dict[tuple[str, int], Tensor] = {}
        self._masks: dict[int, tuple[Tensor, Tensor] | None] = {}

    def _initial_background(self) -> Tensor:
        if self.config.background != "learned":
            return torch.full((3,), 1.0 if self.config.background == "white" else 0.0)
        # A blank background reaches the border of the picture; anywhere else the border's median is as good as any colour.
        # All images are loaded here for the first time, so this goes by threads.
        borders = list(in_order(_border, self.scene.train_frames, nb.get_num_threads()))
        return torch.as_tensor(np.median(np.concatenate(borders), axis=0), dtype=torch.float32)

    def factor(self) -> int:
        """How much smaller than full size this step's image is."""
        for until, factor in self.config.coarse_to_fine:
            if self.step < until * self.steps and min(self.scene.rig.rgb.width, self.scene.rig.rgb.height) // factor >= 48:
                return factor
        return 1

    def image(self, frame: Frame, factor: int) -> Tensor:
        key = (frame.name, factor)
        if factor == 1:
            return torch.from_numpy(frame.rgb)
        if key not in self._images:
            if any(f != factor for _, f in self._images):
                self._images.clear()  # the coarser level is over
            height, width = frame.rgb.shape[:2]
            small = cv2.resize(frame.rgb, (width // factor, height // factor), interpolation=cv2.INTER_AREA)
            self._images[key] = torch.from_numpy(small)
        return self._images[key]

    def mask(self, factor: int) -> tuple[Tensor, Tensor] | None:
        """Valid pixels and the centres of SSIM windows that see nothing else, `[H, W]` bool each; None when all are."""
        if factor not in self._masks:
            mask = self.scene.capture.rgb_mask
            if factor > 1:
                size = (mask.shape[1] // factor, mask.shape[0] // factor)
                mask = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.999
            pixels = torch.from_numpy(np.ascontiguousarray(mask))
            self._masks[factor] = None if mask.all() else (pixels, whole_windows(pixels))
        return self._masks[factor]

    def gaussians(self) -> Gaussians:
        """The model as it stands, with the bands that are switched on."""
        return Gaussians(**self.optimizer.parameters)

    def _rates(self, band: int) -> dict[str, float | Tensor]:
        """Learning rates of this step."""
        progress = self.step / self.steps
        pace = min(max(math.sqrt(RATES_STEPS / self.steps), 1.0), MOST_PACE)
        # One view a step makes every step a noisy one. At the end the noise is averaged away; before, it is what finds better places.
        settling = max(progress - SETTLE_FROM, 0.0) / (1.0 - SETTLE_FROM)
        rate = pace * SETTLE_TO**settling
        harmonics = torch.full((sh.coefficients(band), 1), rate * 2.5e-3 / 20)
        harmonics[0] = rate * 2.5e-3
        return {
            "means": pace * 1.6e-4 * self.scene.extent * 0.01**progress,
            "quats": rate * 1e-3,
            "log_scales": rate * 5e-3,
            "opacity_logits": rate * 5e-2,
            "sh": harmonics,
        }

    def _switch_on(self, band: int) -> None:
        """Add the coefficients, zero, of the bands up to this one, where they are missing."""
        optimizer = self.optimizer
        k = optimizer.parameters["sh"].shape[1]
        missing = sh.coefficients(band) - k
        if missing > 0:
            tensors = (optimizer.parameters["sh"], optimizer.first["sh"], optimizer.second["sh"])
            optimizer.replace("sh", *(torch.nn.functional.pad(t.detach(), (0, 0, 0, missing)) for t in tensors))

    def advance(self) -> None:
        """One step on one training frame."""
        config, scene = self.config, self.scene
        if not self.order:
            self.order = torch.randperm(len(scene.train_frames), generator=self.generator).tolist()
        k = self.order.pop()
        frame = scene.train_frames[k]
        factor = self.factor()
        target, masks = self.image(frame, factor), self.mask(factor)
        camera = scene.rig.rgb.resized(target.shape[1], target.shape[0])

        band = min(self.sh_degree, int(self.step / self.steps * 2 * (self.sh_degree + 1)))
        self._switch_on(band)
        self.optimizer.rates = self._rates(band)
        gaussians, per_frame = self.gaussians(), self.frame_optimizer.parameters
        growing = self.step <= config.densify.stop * self.steps
        offsets = torch.zeros(len(gaussians), 2, requires_grad=growing)
        view = render(gaussians, camera, scene.rgb_from_world(frame.name), settings=self.settings, pixel_offsets=offsets)
        pixels, windows = masks or (None, None)
        loss = photometric(
            view.color,
            view.alpha,
            per_frame["background"],
            per_frame["gain"][k],
            per_frame["offset"][k],
            target,
            ssim_weight=config.ssim_weight,
            pixels=pixels,
            windows=windows,
            parity=self.step % 2,
        )
        loss.backward()
        self.optimizer.step()
        self.frame_optimizer.step()
        self.step += 1
        if offsets.grad is not None:
            self.gradients.add(offsets.grad, view.visible, camera.width, camera.height)
        if is_round(config.densify, self.step, self.steps):
            n = densify(
                self.optimizer,
                self.gradients,
                config.densify,
                target=target_count(config.densify, self.initial, self.budget, self.step, self.steps),
                extent=scene.extent,
                generator=self.generator,
                rotation_from_quats=rotation_from_quats,
            )
            self.gradients = ScreenGradients(n)

    def record(self) -> None:
        """Score the held-out frames: shown, never used."""
        self.history["step"].append(self.step)
        self.history["gaussians"].append(len(self.gaussians()))
        model = self.model()
        scores = []
        for frame in self.scene.held_out_frames:
            image = model.render(self.scene.rig.rgb, self.scene.rgb_from_world(frame.name))
            scores.append(psnr(image, frame.rgb, mask=self.scene.capture.rgb_mask))
        if scores:
            self.history["held_out_psnr"].append(float(np.mean(scores)))

    def summary(self) -> str:
        held_out = self.history["held_out_psnr"]
        text = f"{len(self.gaussians()):,} Gaussians"
        return text + (f", held-out {held_out[-1]:.2f} dB" if held_out else "")

    def model(self) -> RgbModel:
        background = self.frame_optimizer.parameters["background"].detach().clamp(0, 1).clone()
        gaussians = self.gaussians().detach()
        missing = sh.coefficients(self.sh_degree) - gaussians.sh.shape[1]
        gaussians = replace(gaussians, sh=torch.nn.functional.pad(gaussians.sh, (0, 0, 0, missing)))
        return RgbModel(gaussians, background, self.settings, {k: list(v) for k, v in self.history.items()})

    def copied_model(self) -> RgbModel:
        """`model` with tensors of its own: those of the training are changed in place."""
        model = self.model()
        tensors = {name: tensor.clone() for name, tensor in model.gaussians.tensors().items()}
        return replace(model, gaussians=Gaussians(**tensors))

    def save(self, path: Path) -> None:
        state: dict[str, Any] = {
            "config": repr(self.config),
            "step": self.step,
            "generator": self.generator.get_state(),
            "order": self.order,
            "history": self.history,
            "gaussians": self.optimizer.state(),
            "frames": self.frame_optimizer.state(),
            "gradients": (self.gradients.total, self.gradients.count),
        }
        with write_whole(path) as temporary:
            torch.save(state, temporary)

    def restore(self, path: Path) -> None:
        try:
            state = torch.load(path, weights_only=True)
        except Exception as error:  # torch raises half a dozen kinds for a damaged file
            raise RtgsError(f"{path}: the checkpoint is damaged ({error}); remove it to train from the start.") from error
        if state["config"] != repr(self.config):
            raise RtgsError(f"{path}: belongs to other training settings; remove it to start over.")
        self.step, self.order, self.history = state["step"], state["order"], state["history"]
        self.generator.set_state(state["generator"])
        self.optimizer.restore(state["gaussians"])
        self.frame_optimizer.restore(state["frames"])
        self.gradients = ScreenGradients(0)
        self.gradients.total, self.gradients.count = state["gradients"]
