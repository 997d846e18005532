"""Take a run's results elsewhere, in SfM units or in metres."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rtgs.base.files import write_whole
from rtgs.base.json_records import write_json
from rtgs.io.colmap import write_scene
from rtgs.io.ply import write_ply
from rtgs.io.transforms import write_transforms
from rtgs.records.scene import Scene
from rtgs.run.folder import RunFolder, refuse_own_folders
from rtgs.run.model_files import write_thermal_ply


def export(folder: RunFolder, scene: Scene, out: Path, *, metres: bool) -> list[Path]:
    """Write `rgb.ply`, `thermal.ply`, `transforms.json` (RGB poses, nerfstudio form) and `scene/` (COLMAP, both cameras as a rig).

    Where the photographs say where they were taken, `georeference.json` leads from what is written to the Earth.

    Args:
        metres: multiply means, sizes, poses and points by `metres_per_sfm`; else everything is in the given frame, in SfM units.

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
    scaled = replace(scene, given_from_world=scene.given_from_world.in_unit(factor))
    write_ply(out / "rgb.ply", rgb.gaussians, given_from_world=scaled.given_from_world, background=rgb.background.tolist())
    write_thermal_ply(out / "thermal.ply", thermal, scaled.given_from_world)
    files = {name: f"rgb/{name}.png" for name in scaled.world_from_rgb}
    write_transforms(out / "transforms.json", scene.rig.rgb, scaled.as_given().world_from_rgb, files)
    with write_whole(out / "scene") as temporary:
        write_scene(temporary, scaled, scale.sfm_per_metre * factor)
    written = [out / name for name in ("rgb.ply", "thermal.ply", "transforms.json", "scene")]
    if (place := folder.read_georeference()) is None:
        return written
    write_json(out / "georeference.json", place.in_unit(factor))
    return [*written, out / "georeference.json"]
