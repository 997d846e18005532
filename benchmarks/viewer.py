"""How quick `rtgs view` is, how much memory it takes, and whether it grows: measured in a headless Chromium with software graphics.

    python -m benchmarks.viewer RUN [--seconds 20] [--reconnect-minutes 5]

The run is seen in a window whose picture has 640 × 480 pixels, on this machine's cores. One call of `rtgs view` before the measured one
fills the cache of compiled kernels.

| figure | what it is |
|---|---|
| first picture | from the start of the process until the browser has been sent a picture; the browser waits at the address from the start |
| pictures a second | while the mouse turns the view |
| full size | from the last move until the last picture, which is the one at full size |
| memory | highest resident memory of the server |
| growth | of the resident memory, while a page is loaded again every 10 s |
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median

from tests.helpers.chromium import PATIENCE_S, Chromium, Tab, chromium, wait_for

WIDTH, HEIGHT, PANEL = 640, 480, 360
PICTURE_BYTES = 6000  # of a message: everything smaller is a control, and no picture
RELOAD_S = 10.0


@contextlib.contextmanager
def served(run: Path) -> Iterator[tuple[subprocess.Popen[bytes], str, float]]:
    """`rtgs view` in a process of its own: the process, its address, and when it was started."""
    with contextlib.closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "rtgs", "view", str(run), "--port", str(port), "--no-browser"]
    started = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        yield process, f"http://127.0.0.1:{port}", started
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(timeout=30)
        except subprocess.TimeoutExpired:
            process.kill()


def listening(url: str) -> bool:
    host, port = url.removeprefix("http://").split(":")
    with contextlib.closing(socket.socket()) as knock:
        return knock.connect_ex((host, int(port))) == 0


def memory_mb(process: subprocess.Popen[bytes], name: str) -> float:
    """`VmHWM` (highest) or `VmRSS` (now)."""
    lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
    return next(float(line.split()[1]) / 1024 for line in lines if line.startswith(name))


def pictures(tab: Tab) -> list[float]:
    """When the page was sent each of its pictures so far, in seconds of `time.time`."""
    tab.js("0")  # hears what has been told meanwhile
    return [at for at, size in tab.received if size > PICTURE_BYTES]


def open_page(browser: Chromium, url: str) -> Tab:
    tab = browser.tab(WIDTH + PANEL, HEIGHT)
    tab.call("Page.bringToFront")
    wait_for(lambda: listening(url), "the server listens")
    tab.go(url)
    wait_for(lambda: pictures(tab), "there is a picture")
    return tab


def turn(tab: Tab, seconds: float) -> float:
    """Drags the view to and fro; gives the pictures a second."""
    before, started = len(pictures(tab)), time.monotonic()
    k = 0
    tab.mouse("mousePressed", WIDTH / 2, HEIGHT / 2, button="left", buttons=1, clickCount=1)
    while time.monotonic() - started < seconds:
        k += 1
        tab.mouse(
            "mouseMoved", WIDTH / 2 + 40 * ((k % 40) / 20 - 1) * (1 if k // 40 % 2 else -1), HEIGHT / 2, button="left", buttons=1
        )
        time.sleep(1 / 60)
    return (len(pictures(tab)) - before) / (time.monotonic() - started)


def rest(tab: Tab) -> float:
    """Ends the drag; gives the seconds until the last picture."""
    tab.mouse("mouseMoved", WIDTH / 2 + 25, HEIGHT / 2, button="left", buttons=1)
    moved = time.time()
    tab.mouse("mouseReleased", WIDTH / 2 + 25, HEIGHT / 2, button="left", clickCount=1)
    time.sleep(3.0)
    return pictures(tab)[-1] - moved


def measure(run: Path, seconds: float, minutes: float) -> None:
    print(f"{run}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}", flush=True)
    with chromium() as browser:
        with served(run) as (_, url, _):
            open_page(browser, url)  # compiles what is not in the cache
        with served(run) as (process, url, started):
            tab = open_page(browser, url)
            print(f"first picture: {time.monotonic() - started:.1f} s", flush=True)
            for mode in ("RGB", "Temperature"):
                tab.choose("Show", mode)
                time.sleep(2.0)
                rates, waits = [], []
                for _ in range(3):
                    rates.append(turn(tab, seconds / 3))
                    waits.append(rest(tab))
                print(
                    f"{mode}: {median(rates):.1f} pictures a second, full size {median(waits):.2f} s after the last move",
                    flush=True,
                )
            print(f"memory: {memory_mb(process, 'VmHWM'):.0f} MB", flush=True)
            reconnect(browser, process, url, minutes)


def reconnect(browser: Chromium, process: subprocess.Popen[bytes], url: str, minutes: float) -> None:
    """Load a page again and again, and compare the memory after the first minute with that at the end."""
    if minutes <= 0:
        return
    tab, begun, first, count = open_page(browser, url), time.monotonic(), 0.0, 0
    while (gone := time.monotonic() - begun) < 60 * minutes:
        time.sleep(RELOAD_S)
        tab.go(url)
        count += 1
        if not first and gone > 60:
            first = memory_mb(process, "VmRSS")
    wait_for(lambda: "Show" in tab.text(), "the page is there", PATIENCE_S)
    last = memory_mb(process, "VmRSS")
    first = first or last
    print(
        f"{count} reconnections in {minutes:g} min: {first:.0f} MB, then {last:.0f} MB ({100 * (last / first - 1):+.1f} %)",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--seconds", type=float, default=20.0, help="that the view is turned in each mode")
    parser.add_argument("--reconnect-minutes", type=float, default=5.0)
    arguments = parser.parse_args()
    measure(arguments.run, arguments.seconds, arguments.reconnect_minutes)


if __name__ == "__main__":
    main()
