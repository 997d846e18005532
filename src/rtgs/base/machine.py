"""What `rtgs --version -v` says of the machine and the libraries: what a report of a problem should begin with."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

import numba as nb
import numpy as np

from rtgs.base.compiled import kernel
from rtgs.base.errors import RtgsError
from rtgs.base.memory import GIGABYTE, Memory, free_bytes

_LIBRARIES = ("numpy", "torch", "numba", "pycolmap", "opencv-python-headless", "Pillow")


def facts() -> dict[str, str]:
    """Python, libraries, threads with the layer that Numba shares work by, and memory. No path and no host name."""
    found = {"Python": f"{platform.python_version()}, {platform.system()} {platform.machine()}"}
    for name in _LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not found"
    found["threads"] = f"{nb.get_num_threads()}, shared by {threading_layer()}"
    found["memory"] = f"{free_bytes() / GIGABYTE:.1f} GB free"
    try:
        budget = Memory.of()
    except RtgsError as error:
        found["a run"] = str(error)
    else:
        found["a run"] = (
            f"keeps images in up to {budget.images / GIGABYTE:.1f} GB, the thermal fit in {budget.fit / GIGABYTE:.1f} GB"
        )
    return found


def threading_layer() -> str:
    """What shares parallel loops among threads: "omp", "tbb" or "workqueue". Numba decides with the first parallel kernel."""
    _touch(np.zeros(2))
    return str(nb.threading_layer())


@kernel(parallel=True)
def _touch(values):  # type: ignore[no-untyped-def]
    for i in nb.prange(len(values)):
        values[i] = i
