"""Temperatures at a pixel and along a line of a view, in °C and metres: python examples/03_temperature_along_a_line.py [RUN]."""

from dataclasses import replace
from pathlib import Path

import numpy as np

import rtgs
from rtgs.run.folder import RunFolder
from tiny import run_or_tiny


def main(run: Path) -> None:
    folder = RunFolder(run)
    scene = folder.load_scene()
    thermal, scale = folder.read_thermal(), folder.read_scale()
    camera, pose = scene.rig.rgb, scene.rgb_from_world(scene.held_out_frames[0].name)

    temperature_c = thermal.render(camera, pose)  # [H, W], seen from the RGB camera
    view = rtgs.render(thermal.gaussians, camera, pose, settings=replace(thermal.settings, with_depth=True))
    depth_m = (view.depth / view.alpha).numpy() / scene.world_per_metre(scale.sfm_per_metre)  # [H, W]
    row, middle = camera.height // 2, camera.width // 2
    print(f"middle of the view: {temperature_c[row, middle]:.1f} °C at {depth_m[row, middle]:.2f} m")

    for column in np.linspace(0.25, 0.75, 9) * camera.width:
        i = int(column)
        if view.alpha[row, i] > 0.5:  # a surface, not the background
            x_m = (i + 0.5 - camera.cx) / camera.fl_x * depth_m[row, i]
            print(f"x {x_m:+.3f} m, depth {depth_m[row, i]:.3f} m: {temperature_c[row, i]:.1f} °C")


if __name__ == "__main__":
    with run_or_tiny() as finished:
        main(finished)
