"""Take a run's results elsewhere, in SfM units or in metres."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rtgs.base.files import write_whole
from rtgs.io.colmap import write_scene
from rtgs.io.ply import write_ply
from rtgs.io.transforms import write_transforms
from rtgs.maths.geometry import SE3
from rtgs.records.capture import SparsePoints
from rtgs.records.scene import Scene
from rtgs.run.folder import RunFolder, refuse_own_folders
from rtgs.run.model_files import write_thermal_ply


def export(folder: RunFolder, scene: Scene, out: Path, *, metres: bool) -> list[Path]:
    """Write `rgb.ply`, `thermal.ply`, `transforms.json` (RGB poses, nerfstudio form) and `scene/` (COLMAP, both cameras as a rig).

    Args:
        metres: multiply means, sizes, poses and points by `metres_per_sfm`; else everything stays in the unit of the run.

    Returns:
        What was written.

    Raises:
        RtgsError: `out` is the run or lies in the capture, or a stage is missing.
    """
    refuse_own_folders(folder, scene, out)
    scale = folder.read_scale()
    factor = scale.metres_per_sfm if metres else 1.0
    rgb, thermal = folder.read_rgb(), folder.read_thermal()
    out.mkdir(parents=True, exist_ok=True)
    write_ply(out / "rgb.ply", rgb.gaussians.scaled(factor), background=rgb.background.tolist())
    write_thermal_ply(out / "thermal.ply", thermal, factor=factor)
    scaled = scaled_scene(scene, factor)
    files = {name: f"rgb/{name}.png" for name in scaled.world_from_rgb}
    write_transforms(out / "transforms.json", scene.rig.rgb, scaled.world_from_rgb, files)
    with write_whole(out / "scene") as temporary:
        write_scene(temporary, scaled, scale.sfm_per_metre * factor)
    return [out / name for name in ("rgb.ply", "thermal.ply", "transforms.json", "scene")]


def scaled_scene(scene: Scene, factor: float) -> Scene:
    """Poses and points in a unit in which every length is `factor` times larger."""
    return replace(
        scene,
        world_from_rgb={k: SE3(p.rotation, p.translation * factor) for k, p in scene.world_from_rgb.items()},
        points=SparsePoints(scene.points.xyz * factor, scene.points.rgb),
    )
