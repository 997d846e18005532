"""Read any 3DGS model, convert it to metres, write it: python examples/05_model_in_metres.py [MODEL.ply METRES_PER_UNIT OUT.ply]."""

import sys
import tempfile
from pathlib import Path

import torch

import rtgs


def main(ply: Path, metres_per_unit: float, out: Path) -> None:
    gaussians = rtgs.read_ply(ply)  # INRIA's layout: from rtgs, 3DGS, splatfacto, gsplat, Brush
    print(f"{len(gaussians):,} Gaussians of {gaussians.channels} channels")
    metric = gaussians.scaled(metres_per_unit)  # centres and sizes; colours and opacities stay
    rtgs.write_ply(out, metric)
    x_m, y_m, z_m = metric.means.amax(dim=0) - metric.means.amin(dim=0)
    print(f"wrote {out.name}: {x_m:.3g} × {y_m:.3g} × {z_m:.3g} m")


if __name__ == "__main__":
    if len(sys.argv) > 3:
        main(Path(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3]))
    else:
        n = 200  # a made-up model
        shape = {"means": torch.rand(n, 3), "quats": torch.randn(n, 4), "log_scales": torch.full((n, 3), -4.0)}
        model = rtgs.Gaussians(**shape, opacity_logits=torch.zeros(n), sh=torch.randn(n, 4, 3))
        with tempfile.TemporaryDirectory() as folder:
            rtgs.write_ply(Path(folder) / "model.ply", model)
            main(Path(folder) / "model.ply", 0.4, Path(folder) / "metres.ply")
