"""The CUDA back end: what only its adapter has. The laws of all back ends are in test_view*.py."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest
import torch
from tests.helpers.compare_renders import home, value_and_gradients
from tests.helpers.gaussian_clouds import POSE, cloud, pinhole
from tests.helpers.gradients import gradient_of

from rtgs.base.errors import RtgsError
from rtgs.config import Backend
from rtgs.maths.geometry import SE3
from rtgs.records.gaussians import Gaussians
from rtgs.renderer import RenderSettings, check_backend, cuda, render, settings

gsplat = pytest.importorskip("gsplat", reason="gsplat is not installed")


@pytest.mark.parametrize("wanted", [("sh",), ("rotation", "translation"), ("pixel_offsets",), ("means", "opacity_logits")])
def test_gradients_reach_only_what_asks_for_them(wanted: tuple[str, ...], cuda_kernels: None) -> None:
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
    parts = [(x.cpu().double() * torch.randn(x.shape, generator=g, dtype=torch.float64)).sum() for x in (view.color, view.alpha)]
    torch.stack(parts).sum().backward()
    leaves |= {"pixel_offsets": offsets, "rotation": rotation, "translation": translation}
    for name, leaf in leaves.items():
        assert (leaf.grad is not None) == (name in wanted), name
        if name in wanted:
            expected = everything[name]
            assert expected.abs().max() > 1e-3
            torch.testing.assert_close(
                gradient_of(leaf).cpu().double(), expected, rtol=1e-4, atol=1e-5 * expected.abs().max().item()
            )


def test_a_model_without_gaussians_can_be_trained(cuda_kernels: None) -> None:
    model = cloud(0).to(**home("cuda"))
    model.sh.requires_grad_()
    model.opacity_logits.requires_grad_()
    view = render(model, pinhole(20, 18), POSE, settings=RenderSettings(backend="cuda"))
    (view.color.sum() + view.alpha.sum()).backward()
    assert model.sh.grad is not None and model.opacity_logits.grad is not None


def test_pose_and_precision_follow_the_model(cuda_kernels: None) -> None:
    here = home("cuda")["device"]
    single, double = cloud(40).to(here), cloud(40).to(here, torch.float64)
    numpy_pose = SE3(POSE.rotation.numpy(), POSE.translation.numpy())
    options = RenderSettings(backend="cuda", with_depth=True, channel_weights=(0.3, 0.6, 0.1))
    a = render(single, pinhole(37, 21), numpy_pose, settings=options)
    b = render(double, pinhole(37, 21), POSE, settings=options)
    assert a.depth is not None and b.depth is not None
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


@pytest.mark.thorough
def test_gsplat_is_imported_by_the_first_cuda_render_only() -> None:
    code = (
        "import sys, rtgs.renderer, rtgs.renderer.cuda\n"
        "from tests.helpers.compare_renders import draw\n"
        "from tests.helpers.gaussian_clouds import POSE, cloud, pinhole\n"
        "draw(cloud(3), pinhole(8, 8), POSE, 'reference')\n"
        "try: draw(cloud(3).to('cpu'), pinhole(8, 8), POSE, 'cpu')\n"
        "finally: print([m for m in sys.modules if m.startswith('gsplat')])"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2]
    ).stdout
    assert out.strip() == "[]"


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_it_is_refused_with_the_remedy() -> None:
    for refused in (
        lambda: render(cloud(3), pinhole(20, 20), POSE, settings=RenderSettings(backend="cuda")),
        lambda: check_backend("cuda"),
    ):
        with pytest.raises(RtgsError, match=r'backend "cuda".*no GPU.*backend "cpu"'):
            refused()
    check_backend("cpu")
    check_backend("reference")


def test_a_model_on_the_cpu_is_taken_there_and_its_pictures_and_gradients_back(cuda_kernels: None) -> None:
    model, camera, options = cloud(40, 1, 3), pinhole(37, 21), RenderSettings(backend="cuda", with_depth=True)
    there = render(model.to(**home("cuda")), camera, POSE, settings=options)
    leaves = {name: tensor.clone().requires_grad_() for name, tensor in model.tensors().items()}
    offsets = torch.zeros(40, 2, requires_grad=True)
    view = render(Gaussians(**leaves), camera, POSE, settings=options, pixel_offsets=offsets)
    assert view.depth is not None and there.depth is not None
    for back, picture in ((view.color, there.color), (view.alpha, there.alpha), (view.depth, there.depth)):
        assert back.device.type == "cpu" and torch.equal(back, picture.cpu())
    assert view.visible.device.type == "cpu"
    (view.color.sum() + view.depth.sum()).backward()
    for name, leaf in {**leaves, "offsets": offsets}.items():
        assert leaf.grad is not None and leaf.grad.device.type == "cpu" and leaf.grad.any(), name


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_a_model_elsewhere_is_refused_on_the_cpu(backend: Backend) -> None:
    elsewhere = "cuda" if torch.cuda.is_available() else "meta"
    with pytest.raises(RtgsError, match=rf'{elsewhere}.*backend "{backend}".*Gaussians.to\("cpu"\).*backend "cuda"'):
        render(cloud(3).to(elsewhere), pinhole(20, 20), POSE, settings=RenderSettings(backend=backend))


def test_a_missing_gsplat_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda, "device", lambda: torch.device("cpu"))
    monkeypatch.setitem(sys.modules, "gsplat", None)  # makes its import fail
    with pytest.raises(RtgsError, match=r"pip install 'rtgs\[cuda\]'.*\"cpu\""):
        render(cloud(3), pinhole(20, 20), POSE, settings=RenderSettings(backend="cuda"))


def test_missing_kernels_are_named_with_their_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cuda, "device", lambda: torch.device("cpu"))
    uncompiled = ModuleType("gsplat.cuda._backend")
    uncompiled._C = None  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", uncompiled)
    with pytest.raises(RtgsError, match=r"no kernels.*nvcc.*\"cpu\""):
        render(cloud(3), pinhole(20, 20), POSE, settings=RenderSettings(backend="cuda"))
    monkeypatch.setitem(sys.modules, "gsplat.cuda._backend", None)
    with pytest.raises(RtgsError, match=r"could not compile.*nvcc.*\"cpu\""):
        render(cloud(3), pinhole(20, 20), POSE, settings=RenderSettings(backend="cuda"))
