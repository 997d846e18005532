"""Memory does not grow with the number of pairs, but for what is known of each."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import memory as bench
from rtgs.io.capture import load_capture

SMALL = ((96, 54), (64, 52))  # 76 kB a pair in memory


def test_the_made_up_wall_is_one_wall(tmp_path: Path) -> None:
    """Each picture is the first one, moved; the poses and the points say so, and so does the thermal camera."""
    bench.make_wall(tmp_path, 3, *SMALL, step_px=4)
    capture = load_capture(tmp_path)
    first, second = (frame.rgb for frame in capture.frames[:2])
    assert np.abs(first[:, 4:] - second[:, :-4]).mean() < 0.02 < np.abs(first - second).mean()  # but for the JPEG
    assert capture.poses is not None and capture.poses.points is not None
    camera, pose = capture.rig.rgb, capture.poses.world_from_rgb["00001"]
    seen = pose.inverse().apply(capture.poses.points.xyz)
    pixels = camera.project(seen)
    inside = ((pixels > 2) & (pixels < np.array([camera.width, camera.height]) - 2)).all(axis=1)
    shown = second[pixels[inside, 1].astype(int), pixels[inside, 0].astype(int)]
    assert inside.sum() > 50 and np.abs(shown - capture.poses.points.rgb[inside]).mean() < 0.03
    grey = second.mean(axis=2)
    thermal_from_world = (pose @ capture.rig.rgb_from_thermal).inverse()
    there = capture.rig.thermal.project(thermal_from_world.apply(capture.poses.points.xyz))
    both = inside & ((there > 2) & (there < np.array([62, 50]))).all(axis=1)
    warmth = capture.frames[1].thermal[there[both, 1].astype(int), there[both, 0].astype(int)]
    bright = grey[pixels[both, 1].astype(int), pixels[both, 0].astype(int)]
    assert both.sum() > 30 and np.corrcoef(warmth, bright)[0, 1] > 0.8


@pytest.mark.thorough
@pytest.mark.skipif(sys.platform == "win32", reason="os.wait4 tells the peak")
def test_a_pair_takes_little_more_than_its_images(tmp_path: Path) -> None:
    """With memory for a few images, 200 pairs more take less than a quarter of what their images would."""
    peaks = []
    for count in (100, 300):
        bench.make_wall(tmp_path / str(count), count, *SMALL, step_px=4)
        peaks.append(min(bench.load(tmp_path / str(count), cache_bytes=10**6).peak for _ in range(2)))
    assert peaks[1] - peaks[0] < 200 * 19_000
    assert peaks[1] < 250e6
