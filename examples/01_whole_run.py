"""The whole method from Python: python examples/01_whole_run.py [CAPTURE]. Without an argument, on a tiny synthetic capture."""

from pathlib import Path

import rtgs
from tiny import capture_or_tiny


def main(capture: Path, rgb_settings: rtgs.RgbConfig) -> None:
    scene = rtgs.run_sfm(rtgs.load_capture(capture))
    print(f"{len(scene.frames)} frames registered, {len(scene.points)} points")

    rgb = rtgs.fit_rgb(scene, rgb_settings)
    scale = rtgs.estimate_scale(scene, rgb)
    print(f"one metre is {scale.sfm_per_metre:.4g} SfM units, status {scale.status}")

    scene = scale.refined_scene(scene)  # the same scene, unless the calibration was refined with the scale
    thermal = rtgs.fit_thermal(scene, rgb, scale.sfm_per_metre)
    scores = rtgs.evaluate(scene, rgb, thermal)
    print(f"held-out thermal views: {scores.thermal.psnr:.1f} dB, off by {scores.thermal.mae_c:.2f} °C on average")


if __name__ == "__main__":
    with capture_or_tiny() as (folder, settings):
        main(folder, settings)
