"""How much memory a run may take: what the system and its control groups say, and how it is shared out."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rtgs.base.errors import RtgsError
from rtgs.base.memory import GIGABYTE, Memory, free_bytes

MIB = 1 << 20


def system(root: Path, files: dict[str, str | int], groups: str = "", free_kib: int = 8 << 20) -> Path:
    """`proc` and `sys` of a made-up Linux."""
    texts = {"proc/meminfo": f"MemTotal: 99 kB\nMemAvailable: {free_kib} kB\n", "proc/self/cgroup": groups, **files}
    for name, text in texts.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(str(text))
    return root


def test_without_control_groups_what_the_system_has_counts(tmp_path: Path) -> None:
    assert free_bytes(system(tmp_path, {}, free_kib=1234)) == 1234 * 1024


@pytest.mark.parametrize("own", ["/a/b", "/"])  # inside a container the own group may be seen as the top
def test_version_two_of_control_groups(tmp_path: Path, own: str) -> None:
    folder = f"sys/fs/cgroup{own.rstrip('/')}"
    files: dict[str, str | int] = {
        f"{folder}/memory.max": 500 * MIB,
        f"{folder}/memory.current": 300 * MIB,
        f"{folder}/memory.stat": f"anon 1\ninactive_file {50 * MIB}\n",
    }
    assert free_bytes(system(tmp_path, files, f"0::{own}\n")) == 250 * MIB


def test_the_tightest_of_nested_groups_counts(tmp_path: Path) -> None:
    files: dict[str, str | int] = {}
    for folder, limit, used in (("a/b", "max", 1), ("a", 600 * MIB, 500 * MIB), ("", 900 * MIB, 500 * MIB)):
        place = f"sys/fs/cgroup/{folder}".rstrip("/")
        files |= {f"{place}/memory.max": limit, f"{place}/memory.current": used, f"{place}/memory.stat": ""}
    assert free_bytes(system(tmp_path, files, "0::/a/b\n")) == 100 * MIB


@pytest.mark.parametrize(("limit", "expected"), [(400 * MIB, 300 * MIB), (9223372036854771712, 8 << 30)])
def test_version_one_of_control_groups(tmp_path: Path, limit: int, expected: int) -> None:
    folder = "sys/fs/cgroup/memory/x"
    files: dict[str, str | int] = {
        f"{folder}/memory.limit_in_bytes": limit,
        f"{folder}/memory.usage_in_bytes": 150 * MIB,
        f"{folder}/memory.stat": f"total_inactive_file {50 * MIB}\n",
    }
    assert free_bytes(system(tmp_path, files, "9:cpu:/x\n4:memory:/x\n0::/\n")) == expected


def test_a_budget_is_shared_out_and_never_exceeded() -> None:
    for gigabytes in (1.0, 1.7, 4.0, 100.0):
        memory = Memory.of(gigabytes)
        assert min(memory.images, memory.fit) >= 0
        assert memory.images + memory.fit < gigabytes * GIGABYTE
    assert Memory.of(8.0).images > Memory.of(2.0).images and Memory.of(8.0).fit > Memory.of(2.0).fit


def test_the_default_is_the_same_wherever_there_is_enough() -> None:
    """A run that goes on while other programs take memory gives the same numbers to the last bit."""
    assert Memory.within(64 * GIGABYTE) == Memory.within(6 * GIGABYTE)
    assert Memory.within(3 * GIGABYTE).images < Memory.within(6 * GIGABYTE).images


def test_too_little_is_refused_by_name_and_remedy() -> None:
    with pytest.raises(RtgsError, match=r"memory_gb is 0\.5; a run needs 1\.0 or more \(--memory-gb\)"):
        Memory.of(0.5)
    with pytest.raises(RtgsError, match=r"0\.5 GB are free.*--memory-gb 1\.0"):
        Memory.within(500_000_000)


def test_more_than_is_free_is_said() -> None:
    assert Memory.warning(None) == "" == Memory.warning(1e-3)
    assert "1e+06" in Memory.warning(1e6) and "GB are free" in Memory.warning(1e6)


@pytest.mark.thorough
@pytest.mark.parametrize("layer", [None, "workqueue"])
def test_the_threading_layer_is_chosen_and_a_users_choice_is_obeyed(layer: str | None) -> None:
    """OpenMP where Numba has it, whatever else is installed."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_THREADING")}
    environment |= {"NUMBA_THREADING_LAYER": layer} if layer else {}
    done = subprocess.run(
        [sys.executable, "-m", "rtgs", "--version", "-v"], env=environment, capture_output=True, text=True, check=True
    )
    asked = "import rtgs, numba; print(*numba.config.THREADING_LAYER_PRIORITY)"
    order = subprocess.run([sys.executable, "-c", asked], env=environment, capture_output=True, text=True, check=True).stdout
    assert order.split()[0] == "omp"
    omp = subprocess.run([sys.executable, "-c", "from numba.np.ufunc import omppool"], capture_output=True).returncode == 0
    expected = layer or ("omp" if omp else None)
    assert expected is None or f"shared by {expected}" in done.stdout
    assert "GB free" in done.stdout and done.stdout.startswith("rtgs ")
