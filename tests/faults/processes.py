"""Real processes of `rtgs`, stopped at any moment, small disks, and what a run folder holds in the end."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

EXIT_CODES = {signal.SIGKILL: 137, signal.SIGINT: 130, signal.SIGTERM: 143}
NOT_RESULTS = ("config.json", "hashes.json", "report.html", ".lock", "stages.json")
"""Files that hold times, or the place of the capture."""


def results(run: Path) -> dict[str, str]:
    """SHA-256 of every result in a folder, by path. Timings are left out."""
    found = {}
    for path in sorted(run.rglob("*")):
        name = path.relative_to(run).as_posix()
        if not path.is_file() or name in NOT_RESULTS:
            continue
        data = path.read_bytes()
        if name == "metrics.json":
            data = json.dumps({k: v for k, v in json.loads(data).items() if k != "timings_s"}).encode()
        found[name] = hashlib.sha256(data).hexdigest()
    return found


def rtgs(arguments: list[str]) -> subprocess.Popen[str]:
    """`rtgs` as a process that hears Ctrl-C, which a process in the background of a shell does not."""

    def hear() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    command = [sys.executable, "-m", "rtgs", *arguments]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, preexec_fn=hear)


def stopped(arguments: list[str], number: int, after_s: float) -> tuple[int, str]:
    """Start `rtgs` and send it a signal. The exit code as a shell has it (137 for SIGKILL), and what stood on stderr.

    The process may have ended by itself before.
    """
    with rtgs(arguments) as process:
        try:
            process.wait(after_s)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
        errors = process.communicate(timeout=120)[1]
    code = process.returncode
    return (128 - code if code < 0 else code), errors


def processes_at(folder: Path) -> list[int]:
    """Processes, other than this one, that have a file in a folder open or name it in their command."""
    found = []
    for process in Path("/proc").iterdir():
        if not process.name.isdigit() or int(process.name) == os.getpid():
            continue
        try:
            named = str(folder).encode() in (process / "cmdline").read_bytes()
            if named or any(str(folder) in str(file.readlink()) for file in (process / "fd").iterdir()):
                found.append(int(process.name))
        except OSError:  # it has ended
            continue
    return found


def left_behind(folder: Path, patience_s: float = 10.0) -> list[int]:
    """Processes that are still at a folder when the patience has ended."""
    end = time.monotonic() + patience_s
    while (found := processes_at(folder)) and time.monotonic() < end:
        time.sleep(0.05)
    return found


def can_mount() -> bool:
    """Whether this process may mount file systems: root may, outside of most containers."""
    if sys.platform != "linux" or os.geteuid() != 0:
        return False
    trial = ["unshare", "--mount", "mount", "-t", "tmpfs", "tmpfs", "/mnt"]
    return subprocess.run(trial, capture_output=True, check=False).returncode == 0


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[Path]:
    """A file system of so many bytes at a folder that is made."""
    folder.mkdir(parents=True, exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def resize(folder: Path, size: int) -> None:
    """Give a `small_disk` another size."""
    subprocess.run(["mount", "-o", f"remount,size={size}", str(folder)], check=True)


@contextmanager
def read_only(folder: Path) -> Iterator[Path]:
    """The folder cannot be written, not even by root."""
    subprocess.run(["mount", "--bind", str(folder), str(folder)], check=True)
    try:
        subprocess.run(["mount", "-o", "remount,bind,ro", str(folder)], check=True)
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)
