"""How a rival renderer is measured: it runs in a process of its own and does one pass a request, so that `benchmarks/render.py` can take
turns with it, on the same core and whatever else the rival's environment needs.

A request is a line on stdin: `forward` or `both` (forward and backward), then optionally a file to save the result in. The answer is a
line of JSON on stdout with the milliseconds (`ms`, and `processor_ms` of the process) and the peak memory so far.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[np.floating]]


def load_scene() -> dict[str, NDArray[np.float32]]:
    """The scene named on the command line: means `[N, 3]`, quats `[N, 4]` wxyz, log_scales `[N, 3]`, opacity_logits `[N]`,
    sh `[N, 16, 3]`, camera_from_world `[4, 4]`, intrinsics `[3, 3]`, weights `[H, W, 3]`: the loss is Σ weights · image."""
    with np.load(sys.argv[1]) as archive:
        return dict(archive)


def serve(forward: Callable[[], Arrays], both: Callable[[], Arrays]) -> None:
    """Answer requests until stdin ends. Each function gives the image, `both` also the gradients, by the scene's names."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print goes elsewhere
    passes = {"forward": forward, "both": both}
    for line in sys.stdin:
        name, *file = line.split(maxsplit=1)
        start, processor_start = time.perf_counter(), time.process_time()
        result = passes[name]()
        answer = {
            "ms": 1e3 * (time.perf_counter() - start),
            "processor_ms": 1e3 * (time.process_time() - processor_start),
            "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10),
        }
        if file:
            arrays: dict[str, Any] = dict(result)
            np.savez(file[0].strip(), **arrays)
        print(json.dumps(answer), file=answers, flush=True)
