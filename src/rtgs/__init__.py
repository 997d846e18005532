"""Metric-scale RGB–thermal Gaussian splatting: folders of synchronised RGB and thermal photographs in, one metric model out.

>>> import rtgs
>>> scene = rtgs.run_sfm(rtgs.load_capture("capture"))
>>> rgb = rtgs.fit_rgb(scene)
>>> scale = rtgs.estimate_scale(scene, rgb)
>>> thermal = rtgs.fit_thermal(scene, rgb, scale.sfm_per_metre)
>>> rtgs.evaluate(scene, rgb, thermal).thermal.mae_c
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0.dev0"

# torch and Numba each bring an OpenMP whose idle threads spin by default, and so take the cores from one another. The runtimes read
# this when they load, so it has to come before torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

# Numba shares parallel loops among threads through one of three libraries, and takes TBB wherever a system happens to have it. TBB's
# waiting threads give up their turn over and over (sched_yield): on a busy machine others get it, and training becomes several times
# slower than with OpenMP. `workqueue` is last, as it ends the process when two Python threads call parallel kernels at once. This
# is an order of preference: NUMBA_THREADING_LAYER names one layer and is obeyed.
os.environ.setdefault("NUMBA_THREADING_LAYER_PRIORITY", "omp tbb workqueue")

if TYPE_CHECKING:
    from rtgs.base.errors import RtgsError
    from rtgs.config import RgbConfig, ScaleConfig, SfmConfig, SpotsConfig, ThermalConfig
    from rtgs.evaluation.held_out import evaluate
    from rtgs.evaluation.records import Evaluation
    from rtgs.io.capture import load_capture
    from rtgs.io.ply import read_ply, write_ply
    from rtgs.maths.geometry import SE3, Sim3
    from rtgs.models import RgbModel, ThermalModel
    from rtgs.records.camera import Camera
    from rtgs.records.capture import Capture, Frame, Split
    from rtgs.records.gaussians import Gaussians
    from rtgs.records.rig import Rig
    from rtgs.records.scene import Scene
    from rtgs.records.spots import Spot, SpotList
    from rtgs.renderer import Direction, LinearRender, LinearViews, Render, RenderSettings, Tangents, render, render_with_tangents
    from rtgs.rgb.train import fit_rgb
    from rtgs.scale import ScaleEstimate, estimate_scale
    from rtgs.sfm.poses import run_sfm
    from rtgs.thermal import find_spots, fit_thermal, gaussian_temperatures
    from rtgs.viewer.start import view

_WHERE = {
    "base.errors": ("RtgsError",),
    "config": (
        "RgbConfig",
        "ScaleConfig",
        "SfmConfig",
        "SpotsConfig",
        "ThermalConfig",
    ),
    "evaluation.held_out": ("evaluate",),
    "evaluation.records": ("Evaluation",),
    "io.capture": ("load_capture",),
    "io.ply": (
        "read_ply",
        "write_ply",
    ),
    "maths.geometry": (
        "SE3",
        "Sim3",
    ),
    "models": (
        "RgbModel",
        "ThermalModel",
    ),
    "records.camera": ("Camera",),
    "records.capture": (
        "Capture",
        "Frame",
        "Split",
    ),
    "records.gaussians": ("Gaussians",),
    "records.rig": ("Rig",),
    "records.scene": ("Scene",),
    "records.spots": (
        "Spot",
        "SpotList",
    ),
    "renderer": (
        "Direction",
        "LinearRender",
        "LinearViews",
        "Render",
        "RenderSettings",
        "Tangents",
        "render",
        "render_with_tangents",
    ),
    "rgb.train": ("fit_rgb",),
    "scale": (
        "ScaleEstimate",
        "estimate_scale",
    ),
    "sfm.poses": ("run_sfm",),
    "thermal": (
        "find_spots",
        "fit_thermal",
        "gaussian_temperatures",
    ),
    "viewer.start": ("view",),
}
_MODULE_OF = {name: module for module, names in _WHERE.items() for name in names}
__all__ = [
    "SE3",
    "Camera",
    "Capture",
    "Direction",
    "Evaluation",
    "Frame",
    "Gaussians",
    "LinearRender",
    "LinearViews",
    "Render",
    "RenderSettings",
    "RgbConfig",
    "RgbModel",
    "Rig",
    "RtgsError",
    "ScaleConfig",
    "ScaleEstimate",
    "Scene",
    "SfmConfig",
    "Sim3",
    "Split",
    "Spot",
    "SpotList",
    "SpotsConfig",
    "Tangents",
    "ThermalConfig",
    "ThermalModel",
    "estimate_scale",
    "evaluate",
    "find_spots",
    "fit_rgb",
    "fit_thermal",
    "gaussian_temperatures",
    "load_capture",
    "read_ply",
    "render",
    "render_with_tangents",
    "run_sfm",
    "view",
    "write_ply",
]


def __getattr__(name: str) -> Any:
    # Loaded on first use: `import rtgs` alone should not cost what torch costs.
    if name in _MODULE_OF:
        value = getattr(import_module(f"rtgs.{_MODULE_OF[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'rtgs' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
