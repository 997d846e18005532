"""The metric scale alone, with its interval and verdict: python examples/02_scale_and_interval.py [CAPTURE]."""

from pathlib import Path

import rtgs
from tiny import capture_or_tiny


def main(capture: Path, rgb_settings: rtgs.RgbConfig) -> None:
    scene = rtgs.run_sfm(rtgs.load_capture(capture))
    rgb = rtgs.fit_rgb(scene, rgb_settings)
    scale = rtgs.estimate_scale(scene, rgb)

    print(f"status: {scale.status} {scale.reason}")
    print(f"searched {scale.bracket[0]:.3g} to {scale.bracket[1]:.3g}, found {scale.sfm_per_metre:.5g} SfM units per metre")
    if scale.ci95 is not None:
        low, high = scale.ci95
        print(f"95 % interval {low:.5g} to {high:.5g}: ± {50 * (high - low) / scale.sfm_per_metre:.2f} %")
    for other in scale.minima:
        print(f"another minimum at {other.sfm_per_metre:.4g}, better in {100 * other.chance:.0f} % of the resamples")
    for name in scale.disagreeing:
        print(f"look at frame {name}: its own minimum lies far from the answer")
    print(f"a length of 3 SfM units is {3 * scale.metres_per_sfm:.3f} m")


if __name__ == "__main__":
    with capture_or_tiny() as (folder, settings):
        main(folder, settings)
