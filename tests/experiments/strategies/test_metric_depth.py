"""Metric depth: a network that knows the truth gives the true scale; what is no metric model is refused."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from tests.helpers.wall_scene import PLANE_M, RGB, TRUTH, wall_scene

from rtgs.base.errors import RtgsError
from rtgs.experiments.strategies.metric_depth import load_depth_model, scale_from_depth
from rtgs.maths.geometry import Sim3


def test_depths_in_metres_give_the_scale() -> None:
    """A predictor that knows: 1 m to the wall, nothing at the left edge, and one frame all wrong."""
    scene, model = wall_scene()
    frames = {id(f.rgb): f.name for f in scene.frames}

    def predict(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
        metres = np.full(rgb.shape[:2], PLANE_M, np.float32)
        metres[:, :5] = np.nan
        return metres * (7 if frames[id(rgb)] == "f03" else 1)

    assert scale_from_depth(scene, model, predict) == pytest.approx(TRUTH, rel=2e-3)
    in_millimetres = replace(scene, given_from_world=Sim3(1000.0, np.eye(3), np.zeros(3)))
    assert scale_from_depth(in_millimetres, model, predict) == pytest.approx(1000 * TRUTH, rel=2e-3)
    with pytest.raises(RtgsError, match="no positive depth"):
        scale_from_depth(scene, model, lambda rgb: np.zeros(rgb.shape[:2], np.float32))


def test_without_transformers_the_reason_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(RtgsError, match=r"rtgs\[depth\].*--depth-model"):
        load_depth_model(tmp_path)


@pytest.mark.parametrize("kind", ["metric", "relative", "zoedepth"])
def test_a_depth_model_of_transformers_is_read_from_a_folder(tmp_path: Path, kind: str) -> None:
    """Tiny and of random weights: its metres mean nothing, but they are positive, of the picture's size, and give a finite scale."""
    transformers = pytest.importorskip("transformers", reason="needs rtgs[depth]")
    with pytest.raises(RtgsError, match=r"config\.json"):
        load_depth_model(tmp_path)
    torch.manual_seed(0)
    tiny = {"hidden_size": 16, "num_hidden_layers": 4, "num_attention_heads": 2, "reshape_hidden_states": False}
    neck = {"neck_hidden_sizes": [8, 8, 8, 8], "fusion_hidden_size": 8}
    if kind == "zoedepth":
        from transformers.models.zoedepth import ZoeDepthImageProcessor

        stages = [f"stage{i}" for i in range(1, 5)]
        backbone = transformers.BeitConfig(**tiny, intermediate_size=16, image_size=32, patch_size=16, out_features=stages)
        bins = [{"n_bins": 8, "min_depth": 0.001, "max_depth": 10.0, "name": "indoor"}]
        heads = {"bottleneck_features": 8, "num_relative_features": 8, "bin_embedding_dim": 8, "num_attractors": [4, 2, 2, 1]}
        config = transformers.ZoeDepthConfig(backbone_config=backbone, **neck, **heads, bin_configurations=bins)
        transformers.ZoeDepthForDepthEstimation(config).save_pretrained(tmp_path)
        ZoeDepthImageProcessor(size={"height": 32, "width": 32}).save_pretrained(tmp_path)
    else:
        from transformers.models.dpt import DPTImageProcessor

        backbone = transformers.Dinov2Config(**tiny, image_size=28, patch_size=14, out_indices=[1, 2, 3, 4], apply_layernorm=True)
        heads = {"reassemble_hidden_size": 16, "head_hidden_size": 8, "depth_estimation_type": kind, "max_depth": 20}
        config = transformers.DepthAnythingConfig(backbone_config=backbone, **neck, **heads)
        transformers.DepthAnythingForDepthEstimation(config).save_pretrained(tmp_path)
        DPTImageProcessor(size={"height": 28, "width": 28}, keep_aspect_ratio=True, ensure_multiple_of=14).save_pretrained(
            tmp_path
        )
    if kind == "relative":
        with pytest.raises(RtgsError, match="relative depth"):
            load_depth_model(tmp_path)
        return
    predict = load_depth_model(tmp_path)
    scene, model = wall_scene()
    metres = predict(scene.frames[0].rgb)
    assert metres.shape == (RGB.height, RGB.width) and (metres > 0).all() and (metres < 20).all()
    assert np.isfinite(scale_from_depth(scene, model, predict))
