"""RGB and temperature from a place where no photograph was taken: python examples/04_new_viewpoint.py [RUN]."""

from pathlib import Path

from rtgs.images.pictures import palette, save_png, to_picture
from rtgs.maths.geometry import look_at
from rtgs.run.folder import RunFolder
from tiny import run_or_tiny


def main(run: Path) -> None:
    folder = RunFolder(run)
    scene = folder.load_scene()
    rgb, thermal = folder.read_rgb(), folder.read_thermal()

    # Halfway between the first two cameras, looking at the middle of the model.
    first, second = (scene.world_from_rgb[frame.name] for frame in scene.frames[:2])
    middle = rgb.gaussians.means.median(dim=0).values.numpy()
    up = -(first.rotation[:, 1] + second.rotation[:, 1])  # in a camera y points down
    camera_from_world = look_at((first.translation + second.translation) / 2, middle, up).inverse()

    camera = scene.rig.rgb
    temperature_c = thermal.render(camera, camera_from_world)
    save_png(run / "new_view.rgb.png", to_picture(rgb.render(camera, camera_from_world)))
    save_png(run / "new_view.thermal.png", palette(temperature_c, thermal.range.lo, thermal.range.hi))
    print(f"new_view.rgb.png and new_view.thermal.png: {temperature_c.min():.1f} to {temperature_c.max():.1f} °C")


if __name__ == "__main__":
    with run_or_tiny() as finished:
        main(finished)
