"""The measuring instrument: what `benchmarks/render_floor.py` counts, and the rival that everything is compared with."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import render as bench
import render_floor as floor
from rtgs.renderer import RenderSettings, reference, render
from rtgs.renderer.settings import ALPHA_MAX, ALPHA_MIN, COVARIANCE_BLUR_PX2, TRANSMITTANCE_MIN


@pytest.mark.thorough
def test_counts_are_the_references_pairs() -> None:
    model, (camera, pose) = bench.random_cloud(8000), bench.view(40, 24)
    work = floor.work(model, camera, pose, 16)

    double = model.to(torch.float64)
    moving = pose.to_torch(torch.float64)
    centres, covariances, depths = reference.project(double.geometry, camera, moving)
    order = torch.argsort(depths)
    conics = torch.linalg.inv(covariances + COVARIANCE_BLUR_PX2 * torch.eye(2))[order]
    ys, xs = torch.meshgrid(torch.arange(24.0) + 0.5, torch.arange(40.0) + 0.5, indexing="ij")
    d = torch.stack([xs, ys], -1).reshape(-1, 1, 2) - centres[order]
    alpha = torch.sigmoid(double.opacity_logits)[order] * torch.exp(-0.5 * torch.einsum("pni,nij,pnj->pn", d, conics, d))
    alpha = torch.where(alpha < ALPHA_MIN, 0.0, alpha.clamp(max=ALPHA_MAX))
    after = torch.cumprod(1 - alpha, 1)
    # The Gaussian that finishes a pixel is looked at; what lies behind it is not.
    alive = torch.cat([torch.ones(len(d), 1, dtype=torch.bool), (after[:, :-1] > TRANSMITTANCE_MIN)], 1)
    assert ((alpha > 0) & ~alive).any()
    assert work.pairs == int(((alpha > 0) & alive).sum())
    assert work.gaussians == 8000 and work.visible >= int((alpha > 0).any(0).sum())
    assert work.boxes > work.pairs and work.entries >= work.visible


def test_a_pixel_beside_the_cut_off_is_undecided() -> None:
    model, (camera, pose) = bench.random_cloud(1), bench.view(32)
    view = render(model.to(torch.float64), camera, pose, settings=RenderSettings(backend="reference"))
    faint = view.alpha[view.alpha > 0].min().item()
    # Scale the opacity so that the faintest pixel that counts falls on 1/255.
    opacity = torch.sigmoid(model.opacity_logits.double()) * ALPHA_MIN / faint
    for factor, expected in ((1 + 1e-6, True), (1 - 1e-6, True), (1 + 1e-3, False)):
        logits = torch.logit(opacity * factor)
        nudged = type(model)(**{**model.to(torch.float64).tensors(), "opacity_logits": logits})
        assert floor.work(nudged, camera, pose, 16).undecided.any() == expected


@pytest.mark.thorough
def test_the_rival_draws_what_the_reference_draws() -> None:
    pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed")
    import gsplat_torch as rival

    model, (camera, pose) = bench.random_cloud(300).to(torch.float64), bench.view(37, 21)
    image = rival.render(
        model.means,
        model.quats,
        model.log_scales.exp(),
        model.opacity_logits.sigmoid(),
        model.sh,
        torch.tensor(pose.matrix()),
        torch.tensor(np.asarray(camera.matrix), dtype=torch.float64),
        37,
        21,
    )
    expected = render(model, camera, pose, settings=RenderSettings(backend="reference"))
    assert expected.alpha.max() > 0.5
    # gsplat guards its divisions and square roots with constants up to 1e-6.
    torch.testing.assert_close(image, torch.cat([expected.color, expected.alpha[..., None]], 2), rtol=0, atol=1e-6)
