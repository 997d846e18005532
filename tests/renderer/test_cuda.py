"""The CUDA back end: every test of test_render.py that takes a back end, on a GPU and, without one, against gsplat's contract.

The contract: gsplat's own Python wrappers run as they are, and the compiled functions they call are replaced by PyTorch ones, which
restate what the CUDA sources do. So argument names, order, shapes, types, conventions and the gradients that gsplat passes on are
checked on any machine; what remains for a GPU is whether its kernels compute what their PyTorch twins do.
"""

from __future__ import annotations

import inspect
import itertools
import math
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
from tests.renderer import test_render as test_render
from tests.renderer.test_render import POSE, cloud, home, pinhole, value_and_gradients
from torch import Tensor

from rtgs.base.errors import RtgsError
from rtgs.maths.geometry import SE3
from rtgs.renderer import RenderSettings, cuda, render, settings

gsplat = pytest.importorskip("gsplat", reason="gsplat is not installed")
from gsplat.cuda import _torch_impl  # noqa: E402

NEEDS_GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no CUDA GPU")

# --- gsplat's compiled functions, in PyTorch -------------------------------------------------------

Vjp = tuple[Tensor, ...]


def blend(
    centres: Tensor,  # [N, 2]
    conics: Tensor,  # [N, 3]
    colors: Tensor,  # [N, C]
    opacities: Tensor,  # [N]
    width: int,
    height: int,
    tile_size: int,
    tile_offsets: Tensor,  # [tiles_y, tiles_x]
    ids: Tensor,
) -> Tensor:
    """`[H, W, C + 1]`: RasterizeToPixels3DGSFwd.cu, tile by tile; the numbers are that file's."""
    tiles_y, tiles_x = tile_offsets.shape
    starts = [*tile_offsets.flatten().tolist(), len(ids)]
    rows = []
    for j in range(tiles_y):
        row = []
        for i in range(tiles_x):
            listed = ids[starts[j * tiles_x + i] : starts[j * tiles_x + i + 1]].long()
            y = torch.arange(j * tile_size, min((j + 1) * tile_size, height), device=ids.device) + 0.5
            x = torch.arange(i * tile_size, min((i + 1) * tile_size, width), device=ids.device) + 0.5
            d = centres[listed] - torch.stack(torch.meshgrid(x, y, indexing="xy"), -1)[:, :, None]  # [h, w, listed, 2]
            a, b, c = conics[listed].unbind(-1)
            sigma = 0.5 * (a * d[..., 0] ** 2 + c * d[..., 1] ** 2) + b * d[..., 0] * d[..., 1]
            alpha = torch.clamp_max(opacities[listed] * torch.exp(-sigma), 0.999)
            alpha = torch.where((sigma < 0) | (alpha < 1 / 255), torch.zeros_like(alpha), alpha)
            after = torch.cumprod(1 - alpha, dim=-1)
            before = torch.cat([torch.ones_like(after[..., :1]), after[..., :-1]], dim=-1)[..., : len(listed)]
            weights = torch.where(after > 1e-4, alpha * before, torch.zeros_like(alpha))
            row.append(torch.cat([weights @ colors[listed], weights.sum(-1, keepdim=True)], dim=-1))
        rows.append(torch.cat(row, dim=1))
    return torch.cat(rows)


def project(
    means: Tensor, quats: Tensor, scales: Tensor, viewmat: Tensor, k: Tensor, width: int, height: int, eps2d: float
) -> Vjp:
    """Centres, depths, conics and compensations by gsplat's PyTorch functions, of Gaussians before the camera."""
    covars, _ = _torch_impl._quat_scale_to_covar_preci(quats, scales, compute_preci=False)
    _, centres, depths, conics, compensations = _torch_impl._fully_fused_projection(
        means, covars, viewmat[None], k[None], width, height, eps2d=eps2d, near_plane=-math.inf, calc_compensations=True
    )
    return centres[0], depths[0], conics[0], compensations[0]


def vjp(function: Callable[..., Vjp], inputs: list[Tensor], cotangents: list[Tensor]) -> Vjp:
    with torch.enable_grad():
        leaves = [x.detach().double().requires_grad_() for x in inputs]
        gradients = torch.autograd.grad(function(*leaves), leaves, [g.double() for g in cotangents], allow_unused=True)
    return tuple(torch.zeros_like(x) if g is None else g.to(x.dtype) for g, x in zip(gradients, inputs, strict=True))


def check_input(**tensors: Tensor | None) -> None:
    """The macro CHECK_INPUT, and that every floating tensor is read as float."""
    devices = set()
    for name, tensor in tensors.items():
        if tensor is not None:
            assert tensor.is_contiguous(), name
            assert tensor.dtype in (torch.float32, torch.int32, torch.int64), f"{name}: {tensor.dtype}"
            devices.add(tensor.device)
    assert len(devices) == 1


class Kernels:
    """What `gsplat.cuda._backend._C` offers, as far as the back end reaches it; float64 inside, float32 outside."""

    CameraModelType = None  # gsplat's accessor passes through it
    PINHOLE = "pinhole"

    @staticmethod
    def projection_ewa_3dgs_fused_fwd(
        means: Tensor,
        covars: None,
        quats: Tensor,
        scales: Tensor,
        opacities: Tensor,
        viewmats: Tensor,
        ks: Tensor,
        width: int,
        height: int,
        eps2d: float,
        near_plane: float,
        far_plane: float,
        radius_clip: float,
        calc_compensations: bool,
        camera_model: str,
    ) -> Vjp:
        check_input(means=means, quats=quats, scales=scales, opacities=opacities, viewmats=viewmats, ks=ks)
        assert covars is None and camera_model == "pinhole" and viewmats.shape == (1, 4, 4)
        n = len(means)
        _ = means.numel() // (n * 3)  # the kernel's launcher divides so too: no Gaussian ends the process
        depth = means.double() @ viewmats[0, 2, :3].double() + viewmats[0, 2, 3].double()
        kept = torch.nonzero(~((depth.float() < near_plane) | (depth.float() > far_plane)))[:, 0]
        inputs = [x[kept].double() for x in (means, quats, scales)]
        centres, depths, conics, compensations = project(*inputs, viewmats[0].double(), ks[0].double(), width, height, eps2d)
        opacity = opacities[kept].double() * (compensations if calc_compensations else 1.0)
        extend = torch.sqrt(2 * torch.log((opacity * 255).clamp_min(1.0))).clamp_max(3.33)
        variances = conics[:, [2, 0]] / (conics[:, 0] * conics[:, 2] - conics[:, 1] ** 2)[:, None]
        reach = torch.ceil(extend[:, None] * variances.sqrt())
        outside = ((centres + reach <= 0) | (centres - reach >= centres.new_tensor([width, height]))).any(-1)
        drawn = (opacity >= 1 / 255) & ~outside & ~(reach <= radius_clip).all(-1)
        # What is culled is never written: whatever was in that memory.
        radii = torch.zeros(1, n, 2, dtype=torch.int32, device=means.device)
        out = [means.new_full((1, n, *shape), math.nan) for shape in ((2,), (), (3,))]
        factors = means.new_zeros(1, n)
        radii[0, kept[drawn]] = reach[drawn].clamp_max(2**31 - 1).int()
        for target, value in zip((*out, factors), (centres, depths, conics, compensations), strict=True):
            target[0, kept[drawn]] = value[drawn].float()
        return radii, *out, factors

    @staticmethod
    def projection_ewa_3dgs_fused_bwd(
        means: Tensor,
        covars: None,
        quats: Tensor,
        scales: Tensor,
        viewmats: Tensor,
        ks: Tensor,
        width: int,
        height: int,
        eps2d: float,
        camera_model: str,
        radii: Tensor,
        conics: Tensor,
        compensations: Tensor | None,
        v_means2d: Tensor,
        v_depths: Tensor,
        v_conics: Tensor,
        v_compensations: Tensor | None,
        viewmats_requires_grad: bool,
    ) -> tuple[Tensor | None, ...]:
        check_input(v_means2d=v_means2d, v_depths=v_depths, v_conics=v_conics, v_compensations=v_compensations)
        drawn = (radii[0] > 0).all(-1)
        v_factors = torch.zeros_like(v_depths) if v_compensations is None else v_compensations
        cotangents = [v[0, drawn] for v in (v_means2d, v_depths, v_conics, v_factors)]

        def function(means: Tensor, quats: Tensor, scales: Tensor, viewmat: Tensor) -> Vjp:
            return project(means, quats, scales, viewmat, ks[0].double(), width, height, eps2d)

        *parts, v_viewmat = vjp(function, [means[drawn], quats[drawn], scales[drawn], viewmats[0]], cotangents)
        whole = [torch.zeros_like(x) for x in (means, quats, scales)]
        for target, part in zip(whole, parts, strict=True):
            target[drawn] = part
        return whole[0], None, whole[1], whole[2], v_viewmat[None] if viewmats_requires_grad else None

    @staticmethod
    def intersect_tile(
        means2d: Tensor,
        radii: Tensor,
        depths: Tensor,
        image_ids: None,
        gaussian_ids: None,
        n_images: int,
        tile_size: int,
        tiles_x: int,
        tiles_y: int,
        sort: bool,
        segmented: bool,
    ) -> Vjp:
        check_input(means2d=means2d, radii=radii, depths=depths)
        assert n_images == 1 and sort and not segmented and radii.dtype == torch.int32
        counts, keys, ids = _torch_impl._isect_tiles(means2d, radii, depths, tile_size, tiles_x, tiles_y, sort=False)
        keys, order = torch.sort(keys, stable=True)  # as a radix sort is: equal depths keep the model's order
        return counts, keys, ids[order]

    @staticmethod
    def intersect_offset(ids: Tensor, n_images: int, tiles_x: int, tiles_y: int) -> Tensor:
        assert ids.dtype == torch.int64
        return _torch_impl._isect_offset_encode(ids, n_images, tiles_x, tiles_y)

    @staticmethod
    def rasterize_to_pixels_3dgs_fwd(
        means2d: Tensor,
        conics: Tensor,
        colors: Tensor,
        opacities: Tensor,
        backgrounds: None,
        masks: None,
        width: int,
        height: int,
        tile_size: int,
        tile_offsets: Tensor,
        ids: Tensor,
    ) -> Vjp:
        check_input(means2d=means2d, conics=conics, colors=colors, opacities=opacities, offsets=tile_offsets, ids=ids)
        assert backgrounds is None and masks is None and ids.dtype == tile_offsets.dtype == torch.int32
        inputs = [x[0].double() for x in (means2d, conics, colors, opacities)]
        picture = blend(*inputs, width, height, tile_size, tile_offsets[0], ids).float()[None]
        last_ids = torch.zeros(1, height, width, dtype=torch.int32, device=ids.device)  # the backward below does without
        return picture[..., :-1].contiguous(), picture[..., -1:].contiguous(), last_ids

    @staticmethod
    def rasterize_to_pixels_3dgs_bwd(
        means2d: Tensor,
        conics: Tensor,
        colors: Tensor,
        opacities: Tensor,
        backgrounds: None,
        masks: None,
        width: int,
        height: int,
        tile_size: int,
        tile_offsets: Tensor,
        ids: Tensor,
        render_alphas: Tensor,
        last_ids: Tensor,
        v_colors: Tensor,
        v_alphas: Tensor,
        absgrad: bool,
    ) -> tuple[Tensor | None, ...]:
        check_input(v_colors=v_colors, v_alphas=v_alphas)
        listed = torch.unique(ids.long())  # what no tile lists is never read
        inverse = torch.zeros(means2d.shape[1], dtype=torch.int32, device=ids.device)
        inverse[listed] = torch.arange(len(listed), dtype=torch.int32, device=ids.device)
        tensors = (means2d, conics, colors, opacities)

        def function(*inputs: Tensor) -> Vjp:
            return (blend(*inputs, width, height, tile_size, tile_offsets[0], inverse[ids.long()]),)

        parts = vjp(function, [x[0, listed] for x in tensors], [torch.cat([v_colors, v_alphas], dim=-1)[0]])
        whole = [torch.zeros_like(x) for x in tensors]
        for target, part in zip(whole, parts, strict=True):
            target[0, listed] = part
        return None, *whole


# --- every test of test_render.py that takes a back end --------------------------------------------


@pytest.fixture(params=["in PyTorch", pytest.param("on a GPU", marks=NEEDS_GPU)])
def kernels(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "in PyTorch":
        backend = ModuleType("gsplat.cuda._backend")
        backend._C = Kernels  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", backend)
        monkeypatch.setattr(cuda, "_require_gpu", lambda device: None)
    return request.param


def bodies() -> Iterator[Any]:
    """The tests that take `backend`, with every combination of their other parameters."""
    for name, test in vars(test_render).items():
        marks = [m.args for m in getattr(test, "pytestmark", []) if m.name == "parametrize"]
        if name.startswith("test_") and "backend" in inspect.signature(test).parameters:
            names = [argument for argument, _ in marks if argument != "backend"]
            for values in itertools.product(*(values for argument, values in marks if argument != "backend")):
                yield pytest.param(test, dict(zip(names, values, strict=True)), id="-".join([name[5:], *map(str, values)]))


@pytest.mark.parametrize(("body", "arguments"), list(bodies()))
def test_cuda_passes(body: Callable[..., None], arguments: dict[str, Any], kernels: str) -> None:
    if kernels == "on a GPU" and arguments.get("kind") == "needle" and arguments.get("antialiased"):
        pytest.skip("gsplat takes det Σ from a float32 difference, which is noise for a needle")
    body(backend="cuda", **arguments)


def test_the_bodies_are_found() -> None:
    found = {p.values[0].__name__ for p in bodies()}
    assert {"test_compiled_equals_reference", "test_no_gaussian_and_all_culled_are_black", "test_depth_of_a_plane"} <= found


# --- what only the adapter has ---------------------------------------------------------------------


@pytest.mark.parametrize("wanted", [("sh",), ("rotation", "translation"), ("pixel_offsets",), ("means", "opacity_logits")])
def test_gradients_reach_only_what_asks_for_them(wanted: tuple[str, ...], kernels: str) -> None:
    model, camera = cloud(40, 1, 3), pinhole(37, 21)
    everything = value_and_gradients("cuda", model, camera, POSE, RenderSettings())[1]
    leaves = {k: v.clone() for k, v in model.to(**home("cuda")).tensors().items()}
    leaves["pixel_offsets"] = torch.zeros(40, 2, **home("cuda"))
    leaves["rotation"], leaves["translation"] = (x.to(**home("cuda")) for x in (POSE.rotation, POSE.translation))
    for name in wanted:
        leaves[name].requires_grad_()
    offsets, rotation, translation = (leaves.pop(k) for k in ("pixel_offsets", "rotation", "translation"))
    view = render(
        replace(model, **leaves),
        camera,
        SE3(rotation, translation),
        settings=RenderSettings(backend="cuda"),
        pixel_offsets=offsets,
    )
    g = torch.Generator().manual_seed(5)
    loss = sum(
        (x.cpu().double() * torch.randn(x.shape, generator=g, dtype=torch.float64)).sum() for x in (view.color, view.alpha)
    )
    loss.backward()
    leaves |= {"pixel_offsets": offsets, "rotation": rotation, "translation": translation}
    for name, leaf in leaves.items():
        assert (leaf.grad is not None) == (name in wanted), name
        if name in wanted:
            expected = everything[name]
            assert expected.abs().max() > 1e-3
            torch.testing.assert_close(leaf.grad.cpu().double(), expected, rtol=1e-4, atol=1e-5 * expected.abs().max().item())


def test_a_model_without_gaussians_can_be_trained(kernels: str) -> None:
    model = cloud(0).to(**home("cuda"))
    model.sh.requires_grad_()
    model.opacity_logits.requires_grad_()
    view = render(model, pinhole(20, 18), POSE, settings=RenderSettings(backend="cuda"))
    (view.color.sum() + view.alpha.sum()).backward()
    assert model.sh.grad is not None and model.opacity_logits.grad is not None


def test_pose_and_precision_follow_the_model(kernels: str) -> None:
    here = home("cuda")["device"]
    single, double = cloud(40).to(here), cloud(40).to(here, torch.float64)
    numpy_pose = SE3(POSE.rotation.numpy(), POSE.translation.numpy())
    options = RenderSettings(backend="cuda", with_depth=True, channel_weights=(0.3, 0.6, 0.1))
    a = render(single, pinhole(37, 21), numpy_pose, settings=options)
    b = render(double, pinhole(37, 21), POSE, settings=options)
    for x, y in ((a.color, b.color), (a.alpha, b.alpha), (a.depth, b.depth)):
        assert x.dtype == y.dtype == torch.float32 and x.device.type == here
        torch.testing.assert_close(x, y, rtol=1e-5, atol=1e-5)
    assert a.alpha.max() > 0.5


def source(name: str) -> str:
    text = (Path(gsplat.__file__).parent / "cuda" / name).read_text(encoding="utf-8")
    return re.sub(r"\s+", " ", text)


def test_what_is_compiled_into_gsplat_is_what_the_settings_say() -> None:
    # The numbers as the sources beside the installed wrappers have them; `Kernels` restates them.
    forward, project_, common = (source(f) for f in ("csrc/RasterizeToPixels3DGSFwd.cu", "include/Utils.cuh", "include/Common.h"))
    (alpha_min,) = re.findall(r"ALPHA_THRESHOLD \(1\.f / ([\d.]+?)\.?f\)", common)
    (alpha_max,) = re.findall(r"min\(([\d.]+)f, opac \* __expf\(-sigma\)\)", forward)
    (spent,) = re.findall(r"next_T <= ([\de.-]+?)f\)", forward)
    margins = re.findall(r"\+ ([\d.]+)f \* tan_fov[xy];", project_)
    assert float(alpha_min) == pytest.approx(1 / settings.ALPHA_MIN)
    assert float(alpha_max) == settings.ALPHA_MAX
    assert float(spent) == settings.TRANSMITTANCE_MIN
    assert margins and all(float(m) == settings.FRUSTUM_MARGIN for m in margins)
    assert "float px = (float)j + 0.5f; float py = (float)i + 0.5f;" in forward
    # Left out below the near plane, so on it a Gaussian stays unless the plane is moved by one float.
    assert "mean_c.z < near_plane || mean_c.z > far_plane" in source("csrc/ProjectionEWA3DGSFused.cu")
    assert "glm::vec<2, float>" in common  # float32 throughout


# --- what is refused -------------------------------------------------------------------------------


def test_gsplat_is_imported_by_the_first_cuda_render_only() -> None:
    code = (
        "import sys, rtgs.renderer, rtgs.renderer.cuda\n"
        "from tests.renderer.test_render import *\n"
        "draw(cloud(3), pinhole(8, 8), POSE, 'reference')\n"
        "try: draw(cloud(3).to('cpu'), pinhole(8, 8), POSE, 'cpu')\n"
        "finally: print([m for m in sys.modules if m.startswith('gsplat')])"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2]
    ).stdout
    assert out.strip() == "[]"


@pytest.mark.parametrize(("there", "remedy"), [(False, 'no GPU.*backend "cpu"'), (True, r'Gaussians.to\("cuda"\)')])
def test_a_model_on_the_cpu_is_refused(monkeypatch: pytest.MonkeyPatch, there: bool, remedy: str) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: there)
    with pytest.raises(RtgsError, match=f'"cpu" and backend "cuda".*{remedy}'):
        render(cloud(3), pinhole(20, 20), POSE, settings=RenderSettings(backend="cuda"))


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_model_elsewhere_is_refused_on_the_cpu(backend: str) -> None:
    elsewhere = "cuda" if torch.cuda.is_available() else "meta"
    with pytest.raises(RtgsError, match=rf'{elsewhere}.*backend "{backend}".*Gaussians.to\("cpu"\).*backend "cuda"'):
        render(cloud(3).to(elsewhere), pinhole(20, 20), POSE, settings=RenderSettings(backend=backend))


def test_a_missing_gsplat_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda, "_require_gpu", lambda device: None)
    monkeypatch.setitem(sys.modules, "gsplat", None)  # makes its import fail
    with pytest.raises(RtgsError, match=r"pip install 'rtgs\[cuda\]'.*\"cpu\""):
        render(cloud(3), pinhole(20, 20), POSE, settings=RenderSettings(backend="cuda"))


def test_missing_kernels_are_named_with_their_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda, "_require_gpu", lambda device: None)
    uncompiled = ModuleType("gsplat.cuda._backend")
    uncompiled._C = None  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", uncompiled)
    with pytest.raises(RtgsError, match=r"no kernels.*nvcc.*\"cpu\""):
        render(cloud(3), pinhole(20, 20), POSE, settings=RenderSettings(backend="cuda"))
    monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", None)
    with pytest.raises(RtgsError, match=r"could not compile.*nvcc.*\"cpu\""):
        render(cloud(3), pinhole(20, 20), POSE, settings=RenderSettings(backend="cuda"))
