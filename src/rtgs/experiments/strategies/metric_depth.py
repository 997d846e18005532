"""The scale from a network that predicts depth in metres: how many SfM units are a metre of it, by the median.

Models are read by `transformers` from a local folder, as `save_pretrained` or a download from a hub leaves it. Of permissive licence are
Depth Anything V2 Metric, small, indoor or outdoor (Apache-2.0), and ZoeDepth (MIT).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.experiments.strategies.strategy import Given, Placement, Strategy, content_of
from rtgs.models import RgbModel
from rtgs.records.scene import Scene
from rtgs.renderer import render

DepthPredictor = Callable[[NDArray[np.float32]], NDArray[np.float32]]
"""RGB `[H, W, 3]` in [0, 1] → metres along the optical axis `[H, W]`."""

OPAQUE = 0.95  # elsewhere the model's depth is a mixture
ABSENT = (
    "needs `pip install 'rtgs[depth]'` and a model in a local folder, --depth-model FOLDER: for instance "
    "depth-anything/Depth-Anything-V2-Metric-Indoor-Small-hf (Apache-2.0) or Intel/zoedepth-nyu-kitti (MIT)"
)


def scale_from_depth(scene: Scene, rgb_model: RgbModel, predict: DepthPredictor, *, progress: Progress | None = None) -> float:
    """`sfm_per_metre`: median over training frames of the median, over opaque pixels, of rendered SfM depth ÷ predicted metres.

    Raises:
        RtgsError: no frame has a pixel with both.
    """
    settings = replace(rgb_model.settings, with_depth=True)
    ratios = []
    for done, frame in enumerate(scene.train_frames):
        with torch.no_grad():
            view = render(rgb_model.gaussians, scene.rig.rgb, scene.rgb_from_world(frame.name), settings=settings)
        assert view.depth is not None
        alpha, metres = view.alpha.numpy(), predict(frame.rgb)
        known = scene.capture.rgb_mask & (alpha > OPAQUE) & np.isfinite(metres) & (metres > 0)
        if known.any():
            ratios.append(float(np.median(view.depth.numpy()[known] / alpha[known] / metres[known])))
        if progress is not None:
            progress(done + 1, len(scene.train_frames), frame.name)
    if not ratios:
        raise RtgsError("the depth model predicts no positive depth where the RGB model is opaque")
    return float(np.median(ratios)) * scene.given_from_world.factor


def load_depth_model(folder: Path) -> DepthPredictor:
    """A metric depth model from a local folder.

    Raises:
        RtgsError: `transformers` is missing, the folder holds no depth model, or one whose depth is relative.
    """
    try:
        from transformers import AutoImageProcessor, AutoModelForDepthEstimation
    except ImportError as error:
        raise RtgsError(f"--depth-model: {ABSENT}") from error
    if not (folder / "config.json").is_file():
        raise RtgsError(f"--depth-model {folder}: no config.json there; it is a folder that holds a model as its hub has it.")
    try:
        processor = AutoImageProcessor.from_pretrained(folder, local_files_only=True)
        model = AutoModelForDepthEstimation.from_pretrained(folder, local_files_only=True).eval()
    except (OSError, ValueError) as error:
        raise RtgsError(f"--depth-model {folder}: not read by transformers: {str(error).splitlines()[0]}") from error
    kind = model.config.model_type
    if kind != "zoedepth" and getattr(model.config, "depth_estimation_type", "relative") != "metric":
        raise RtgsError(f"--depth-model {folder}: a {kind} of relative depth, which knows no metres. The row {ABSENT}.")

    def predict(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
        # Not padded: what takes the padding of ZoeDepth off again needs torchvision.
        inputs = processor(images=(rgb * 255 + 0.5).astype(np.uint8), do_pad=False, return_tensors="pt")
        with torch.no_grad():
            metres = model(**inputs).predicted_depth[:, None]
        whole = functional.interpolate(metres, size=rgb.shape[:2], mode="bilinear", align_corners=False)
        return np.asarray(whole[0, 0].numpy(), np.float32)

    return predict


def _place(given: Given, progress: Progress) -> Placement:
    folder = given.config.depth_model
    if folder is None:
        raise RtgsError(ABSENT)
    predict = load_depth_model(folder)
    return Placement(given.scene, scale_from_depth(given.scene, given.rgb_model, predict, progress=progress))


METRIC_DEPTH = Strategy("depth", "Metric depth", _place, lambda given: content_of(given.config.depth_model))
