"""The scale from MASt3R's metric pairs: SfM length ÷ predicted metres between two cameras, the median over pairs.

MASt3R (Leroy, Cabon and Revaud, 2024) and its weights are CC BY-NC-SA 4.0. Nothing of it is here: its own package is imported if it can be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.base.progress import Progress
from rtgs.experiments.strategies.strategy import Given, Placement, Strategy, content_of
from rtgs.records.camera import Camera
from rtgs.records.capture import Frame
from rtgs.records.scene import Scene

PairPredictor = Callable[[Frame, Frame, Camera], float | None]
"""Two frames and their RGB camera → metres between them, or None where the pair says nothing."""

PAIRS = 40
OVERLAP = 0.5  # of the points that a frame sees, its partner sees
TURN_DEG = 30.0
LONG_SIDE_PX, PATCH_PX = 512, 16
LEAST_INLIERS = 100
REPROJECTION_PX = 3.0
ABSENT = (
    "needs the package mast3r (github.com/naver/mast3r and its dust3r, CC BY-NC-SA 4.0) on PYTHONPATH and its weights, "
    "--mast3r-weights MASt3R_ViTLarge_BaseDecoder_512_catmlpdpt_metric.pth"
)


def scale_from_pairs(scene: Scene, predict: PairPredictor, *, progress: Progress | None = None) -> float:
    """`sfm_per_metre`: median over pairs of training frames of SfM length ÷ predicted metres.

    Raises:
        RtgsError: no pair of frames overlaps, or the predictor says nothing of any.
    """
    pairs = overlapping_pairs(scene)
    frames = {f.name: f for f in scene.train_frames}
    ratios = []
    for done, (a, b) in enumerate(pairs):
        metres = predict(frames[a], frames[b], scene.rig.rgb)
        if metres is not None and np.isfinite(metres) and metres > 0:
            length = np.linalg.norm(scene.world_from_rgb[a].translation - scene.world_from_rgb[b].translation)
            ratios.append(float(length) * scene.given_from_world.factor / metres)
        if progress is not None:
            progress(done + 1, len(pairs), f"{a} – {b}")
    if not ratios:
        raise RtgsError(f"none of {len(pairs)} pairs of overlapping frames has a pose in metres")
    return float(np.median(ratios))


def overlapping_pairs(scene: Scene) -> list[tuple[str, str]]:
    """For each training frame the farthest other one that looks the same way and at the same sparse points; at most `PAIRS`."""
    frames = scene.train_frames
    camera, points = scene.rig.rgb, scene.points.xyz
    seen = np.zeros((len(frames), len(points)), bool)
    for i, frame in enumerate(frames):
        in_camera = scene.rgb_from_world(frame.name).apply(points)
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v = camera.project(in_camera).T
        seen[i] = (in_camera[:, 2] > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    poses = [scene.world_from_rgb[f.name] for f in frames]
    centres = np.stack([p.translation for p in poses])
    axes = np.stack([p.rotation[:, 2] for p in poses])
    found: dict[frozenset[int], None] = {}  # in order, each once
    for i in range(len(frames)):
        same = axes @ axes[i] > np.cos(np.radians(TURN_DEG))
        if len(points):
            same &= (seen & seen[i]).sum(axis=1) > OVERLAP * max(1, seen[i].sum())
        distance = np.where(same, np.linalg.norm(centres - centres[i], axis=1), 0.0)
        if distance.max() > 0:
            found.setdefault(frozenset((i, int(distance.argmax()))))
    pairs = [tuple(sorted(pair)) for pair in found]
    chosen = sorted(set(np.linspace(0, len(pairs) - 1, min(PAIRS, len(pairs))).round().astype(int).tolist()))
    return [(frames[pairs[k][0]].name, frames[pairs[k][1]].name) for k in chosen]


def load_mast3r(weights: Path) -> PairPredictor:
    """MASt3R with local weights, on the GPU where there is one.

    Raises:
        RtgsError: the package or the file is missing, or one does not fit the other.
    """
    if not weights.exists():
        raise RtgsError(f"--mast3r-weights {weights}: no such file; the row {ABSENT}.")
    try:
        from mast3r.model import AsymmetricMASt3R  # first: it puts dust3r on the path
        from dust3r.inference import inference  # isort: skip
    except ImportError as error:
        raise RtgsError(f"{ABSENT}; missing is {error.name or error}") from error
    device = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        model = AsymmetricMASt3R.from_pretrained(str(weights)).to(device).eval()
    except (OSError, RuntimeError, KeyError) as error:
        raise RtgsError(f"--mast3r-weights {weights}: not read by mast3r: {error}") from error

    def predict(a: Frame, b: Frame, camera: Camera) -> float | None:
        (first, _), (second, small) = (_as_view(f, i, camera) for i, f in enumerate((a, b)))
        out = inference([(first, second)], model, device, batch_size=1, verbose=False)
        points = out["pred2"]["pts3d_in_other_view"][0].float().cpu().numpy()
        return metres_between(points, out["pred2"]["conf"][0].float().cpu().numpy(), small)

    return predict


def metres_between(points_a: NDArray[np.float32], confidence: NDArray[np.float32], camera_b: Camera) -> float | None:
    """Distance of two cameras, given for each pixel of the second the point that it shows, in the first one's axes and in metres.

    The second camera is placed by PnP on the more confident half of its pixels.

    Args:
        points_a: `[h, w, 3]`. confidence: `[h, w]`. camera_b: the second camera at that size.

    Returns:
        None where too few points agree on a pose.
    """
    y, x = np.nonzero((confidence >= np.median(confidence)) & np.isfinite(points_a).all(axis=-1))
    if len(x) < LEAST_INLIERS:
        return None
    done, _, shift, inliers = cv2.solvePnPRansac(
        points_a[y, x].astype(np.float64),
        np.stack([x, y], axis=1).astype(np.float64),
        camera_b.opencv_matrix,
        None,
        iterationsCount=200,
        reprojectionError=REPROJECTION_PX,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not done or inliers is None or len(inliers) < LEAST_INLIERS:
        return None
    return float(np.linalg.norm(shift))  # b_from_a's translation is as long as its inverse's


def _as_view(frame: Frame, index: int, camera: Camera) -> tuple[dict[str, Any], Camera]:
    """What MASt3R reads: long side 512, sides multiples of 16, never square; and the camera of that picture."""
    scale = LONG_SIDE_PX / max(camera.width, camera.height)
    width, height = round(camera.width * scale), round(camera.height * scale)
    small = cv2.resize(frame.rgb, (width, height), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    w, h = width // PATCH_PX * PATCH_PX, height // PATCH_PX * PATCH_PX
    h = min(h, 3 * w // 4 // PATCH_PX * PATCH_PX) if w == h else h
    left, top = (width - w) // 2, (height - h) // 2
    resized = camera.resized(width, height)
    cropped = replace(resized, width=w, height=h, cx=resized.cx - left, cy=resized.cy - top)
    image = torch.from_numpy(np.ascontiguousarray(small[top : top + h, left : left + w].clip(0, 1) * 2 - 1))
    view = {
        "img": image.permute(2, 0, 1)[None].contiguous(),
        "true_shape": np.array([[h, w]], np.int32),
        "idx": index,
        "instance": str(index),
    }
    return view, cropped


def _place(given: Given, progress: Progress) -> Placement:
    weights = given.config.mast3r_weights
    if weights is None:
        raise RtgsError(ABSENT)
    return Placement(given.scene, scale_from_pairs(given.scene, load_mast3r(weights), progress=progress))


MAST3R = Strategy("mast3r", "MASt3R", _place, lambda given: content_of(given.config.mast3r_weights))
