"""Train the RGB model, the anchor that the scale is found against."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from rtgs.base.errors import RtgsError
from rtgs.base.files import write_whole
from rtgs.base.memory import Memory
from rtgs.base.progress import Progress
from rtgs.config import RgbConfig
from rtgs.losses.photometric import Appearance, photometric
from rtgs.maths import sh
from rtgs.maths.adam import Adam
from rtgs.metrics.basic import psnr
from rtgs.models import RgbModel
from rtgs.records.gaussians import Gaussians
from rtgs.records.scene import Scene
from rtgs.renderer import render
from rtgs.rgb.densify import ScreenGradients, budget, densify, is_round, target_count
from rtgs.rgb.images import TrainingImages
from rtgs.rgb.initial import initial_background, initial_gaussians, starting_points
from rtgs.rgb.schedule import active_band, learning_rates, reduction
from rtgs.rgb.settings import render_settings


def fit_rgb(
    scene: Scene,
    config: RgbConfig | None = None,
    *,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
    snapshot: Callable[[int, RgbModel], None] | None = None,
    memory: Memory | None = None,
) -> RgbModel:
    """Train 3D Gaussians on the scene's training frames (Kerbl et al. 2023).

    Args:
        scene: at least one training frame.
        config: `RgbConfig()` when None.
        checkpoint: where to keep the state while training; a file that is there is continued, bit for bit.
        progress: called with (step, steps, text).
        snapshot: called with (step, model) about twenty times while the model grows. The model is a copy.
        memory: what the run may take; None: the default.

    Raises:
        RtgsError: no training frame, cameras all in one point, a checkpoint of another configuration, or a back end that cannot run
            on this machine.
    """
    config = config or RgbConfig()
    if not scene.train_frames:
        raise RtgsError("fit_rgb: the scene has no training frame (every registered frame is held out).")
    if scene.extent == 0.0:
        raise RtgsError("fit_rgb: all frames were taken from one point; depth needs cameras that stand apart.")
    training = Training(scene, config, memory)
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


class Training:
    """A training run with all its state, so that it can be saved and continued.

    Attributes:
        step, steps: how many steps were made, of how many.
        optimizer: of the Gaussians, with the bands that are switched on.
        frame_optimizer: of the background `[3]`, and of a gain and an offset for each training frame, `[F, 3]` each.
        settings: how the model is rendered.
        history: see `RgbModel`.
    """

    def __init__(self, scene: Scene, config: RgbConfig, memory: Memory | None = None) -> None:
        config, scene = config.resolved(), scene.steady()
        assert config.steps is not None and config.sh_degree is not None
        self.scene, self.config = scene, config
        self.step, self.steps, self.sh_degree = 0, config.steps, config.sh_degree
        self.generator = torch.Generator().manual_seed(config.seed)
        self.settings = render_settings(scene.extent, config.backend, antialiased=config.antialiased)
        self.images = TrainingImages(scene, None if memory is None else memory.reduced)
        self.budget = budget(config.densify, scene.rig.rgb.width * scene.rig.rgb.height, len(scene.points))
        start = initial_gaussians(*starting_points(scene, config, self.budget), 0)  # bands join as they are switched on
        self.initial = len(start)
        self.optimizer = Adam(start.tensors(), learning_rates(0, self.steps, scene.extent, 0))
        frame_parameters = {
            "background": initial_background(scene, config),
            "gain": torch.ones(len(scene.train_frames), 3),
            "offset": torch.zeros(len(scene.train_frames), 3),
        }
        exposure = 1e-3 if config.exposure else 0.0
        background = 2e-3 if config.background == "learned" else 0.0
        self.frame_optimizer = Adam(frame_parameters, {"background": background, "gain": exposure, "offset": exposure})
        self.gradients = ScreenGradients(self.initial)
        self.order: list[int] = []
        self.history: dict[str, list[float]] = {"step": [], "gaussians": [], "held_out_psnr": []}

    def gaussians(self) -> Gaussians:
        """The model as it stands, with the bands that are switched on."""
        return Gaussians(**self.optimizer.parameters)

    def advance(self) -> None:
        """One step on one training frame."""
        config, scene, rgb = self.config, self.scene, self.scene.rig.rgb
        if not self.order:
            self.order = torch.randperm(len(scene.train_frames), generator=self.generator).tolist()
        k = self.order.pop()
        frame = scene.train_frames[k]
        target = self.images.target(frame, reduction(config.coarse_to_fine, self.step, self.steps, min(rgb.width, rgb.height)))
        camera = rgb.resized(target.image.shape[1], target.image.shape[0])

        band = active_band(self.step, self.steps, self.sh_degree)
        self._switch_on(band)
        self.optimizer.rates = learning_rates(self.step, self.steps, scene.extent, band)
        gaussians, per_frame = self.gaussians(), self.frame_optimizer.parameters
        growing = self.step <= config.densify.stop * self.steps
        offsets = torch.zeros(len(gaussians), 2, requires_grad=growing)
        view = render(gaussians, camera, scene.rgb_from_world(frame.name), settings=self.settings, pixel_offsets=offsets)
        appearance = Appearance(per_frame["background"], per_frame["gain"][k], per_frame["offset"][k])
        parity = self.step % 2
        photometric(view.color, view.alpha, appearance, target, ssim_weight=config.ssim_weight, parity=parity).backward()
        self.optimizer.step()
        self.frame_optimizer.step()
        self.step += 1
        if offsets.grad is not None:
            self.gradients.add(offsets.grad, view.visible, camera.width, camera.height)
        if is_round(config.densify, self.step, self.steps):
            self._densify()

    def _switch_on(self, band: int) -> None:
        """Add the coefficients, zero, of the bands up to this one, where they are missing."""
        optimizer = self.optimizer
        k = optimizer.parameters["sh"].shape[1]
        missing = sh.coefficients(band) - k
        if missing > 0:
            tensors = (optimizer.parameters["sh"], optimizer.first["sh"], optimizer.second["sh"])
            optimizer.replace("sh", *(torch.nn.functional.pad(t.detach(), (0, 0, 0, missing)) for t in tensors))

    def _densify(self) -> None:
        n = densify(
            self.optimizer,
            self.gradients,
            self.config.densify,
            target=target_count(self.config.densify, self.initial, self.budget, self.step, self.steps),
            extent=self.scene.extent,
            generator=self.generator,
        )
        self.gradients = ScreenGradients(n)

    def record(self) -> None:
        """Add a line to the history. Held-out frames are scored for information only."""
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
        """Progress in words."""
        held_out = self.history["held_out_psnr"]
        text = f"{len(self.gaussians()):,} Gaussians"
        return text + (f", held-out {held_out[-1]:.2f} dB" if held_out else "")

    def model(self) -> RgbModel:
        """The model as it stands, with all bands."""
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
        """Write the state that `restore` continues from, bit for bit."""
        state: dict[str, Any] = {
            "config": self._belongs_to,
            "step": self.step,
            "generator": self.generator.get_state(),
            "order": self.order,
            "history": self.history,
            "gaussians": self.optimizer.state(),
            "frames": self.frame_optimizer.state(),
            "gradients": (self.gradients.total, self.gradients.count),
        }
        buffer = io.BytesIO()
        torch.save(state, buffer)  # to a file on a full disk, torch raises a RuntimeError that says nothing of the disk
        with write_whole(path) as temporary:
            temporary.write_bytes(buffer.getbuffer())

    @property
    def _belongs_to(self) -> str:
        """Settings and world, which a saved state can be continued in."""
        given = self.scene.given_from_world
        return repr((self.config, given.factor, given.translation.tolist()))

    def restore(self, path: Path) -> None:
        """Continue from a saved state.

        Raises:
            RtgsError: the file is damaged, or belongs to other settings.
        """
        try:
            state = torch.load(path, weights_only=True)
        except Exception as error:  # torch raises half a dozen kinds for a damaged file
            raise RtgsError(f"{path}: the checkpoint is damaged ({error}); remove it to train from the start.") from error
        if state["config"] != self._belongs_to:
            raise RtgsError(f"{path}: belongs to other training settings or to another version; remove it to start over.")
        self.step, self.order, self.history = state["step"], state["order"], state["history"]
        self.generator.set_state(state["generator"])
        self.optimizer.restore(state["gaussians"])
        self.frame_optimizer.restore(state["frames"])
        self.gradients = ScreenGradients(0)
        self.gradients.total, self.gradients.count = state["gradients"]
