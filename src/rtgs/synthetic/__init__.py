"""Synthetic captures with exact truth: procedural scenes, ray-cast, seen by a two-camera rig.

```python
from pathlib import Path
from rtgs.synthetic import SynthConfig, write_capture

truth = write_capture(Path("capture"), SynthConfig(scene="lego", size=200))
truth.sfm_per_metre  # what `estimate_scale` should find
```
"""

from rtgs.config import SCENES, SceneName, SynthConfig
from rtgs.synthetic.capture import GroundTruth, compiled_scene, write_capture
from rtgs.synthetic.raycast import render_rgb, render_thermal

__all__ = ["SCENES", "GroundTruth", "SceneName", "SynthConfig", "compiled_scene", "render_rgb", "render_thermal", "write_capture"]
