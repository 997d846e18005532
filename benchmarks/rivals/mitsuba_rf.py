"""Mitsuba 3's `volprim_rf_basic`: ellipsoids traced along rays, on its LLVM back end.

    python -m venv mitsuba && mitsuba/bin/pip install mitsuba==3.9.1
    apt install libllvm19                   # LLVM 15 fails on AVX-512 machines; DRJIT_LIBLLVM_PATH names another libLLVM.so
    python benchmarks/render.py --only rivals --rival mitsuba_rf=mitsuba/bin/python

It meets ellipsoids in the order in which a ray enters them, not by depth of their centres, and does not blur by half a pixel: the
picture is another one by design. One sample a pixel. Gradients are of means, scales and quaternions together, opacities and SH.
"""

from __future__ import annotations

import math
import os

import drjit as dr
import mitsuba as mi
import numpy as np
from server import load_scene, serve

mi.set_variant("llvm_ad_rgb")
dr.set_thread_count(int(os.environ["OMP_NUM_THREADS"]))


def main() -> None:
    s = load_scene()
    height, width, _ = s["weights"].shape
    quats = s["quats"] / np.linalg.norm(s["quats"], axis=1, keepdims=True)
    mitsuba_from_opencv = np.diag([-1.0, -1.0, 1.0, 1.0])  # x left, y up, z forward
    opacities = 1.0 / (1.0 + np.exp(-s["opacity_logits"]))
    arrays = {
        "centers": s["means"],
        "scales": np.exp(s["log_scales"]),
        "quaternions": quats[:, [1, 2, 3, 0]],
        "opacities": opacities[:, None],
        "sh_coeffs": s["sh"].reshape(len(quats), -1),
    }
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volprim_rf_basic", "max_depth": 1024, "srgb_primitives": False},
            "sensor": {
                "type": "perspective",
                "fov": 2 * math.degrees(math.atan(width / 2 / s["intrinsics"][0, 0])),
                "to_world": mi.ScalarTransform4f(np.linalg.inv(s["camera_from_world"].astype(np.float64)) @ mitsuba_from_opencv),
                "film": {
                    "type": "hdrfilm",
                    "width": width,
                    "height": height,
                    "rfilter": {"type": "box"},
                    "pixel_format": "rgb",
                    "component_format": "float32",
                },
                "sampler": {"type": "independent", "sample_count": 1},
            },
            "gaussians": {
                "type": "ellipsoids",
                "extent": 3.33,  # σ, as gsplat's radii
                "extent_adaptive_clamping": True,
                **{k: mi.TensorXf(np.ascontiguousarray(v).ravel(), v.shape) for k, v in arrays.items()},
            },
        }
    )
    parameters = mi.traverse(scene)
    keys = [f"gaussians.{name}" for name in ("data", "opacities", "sh_coeffs")]
    weights = mi.TensorXf(s["weights"])

    def forward() -> dict[str, np.ndarray]:
        return {"image": np.array(mi.render(scene, spp=1, seed=0))}

    def both() -> dict[str, np.ndarray]:
        for key in keys:
            dr.enable_grad(parameters[key])
        image = mi.render(scene, parameters, spp=1, seed=0, seed_grad=1)
        dr.backward(dr.sum(image * weights, axis=None))
        gradients = [dr.grad(parameters[key]) for key in keys]
        dr.eval(gradients)
        dr.sync_thread()
        for key in keys:
            dr.disable_grad(parameters[key])
        return {"image": np.array(image)}

    serve(forward, both)


if __name__ == "__main__":
    main()
