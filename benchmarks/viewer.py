"""How quick `rtgs view` is, how much memory it takes, and whether it grows: measured in a headless Chromium with software graphics.

    python -m benchmarks.viewer RUN [--seconds 20] [--reconnect-minutes 5]

The run is seen in a window whose picture has 640 × 480 pixels, on this machine's cores. A first viewer fills the cache of compiled
kernels.

| figure | what it is |
|---|---|
| first picture | from the start of the process until it has sent the browser a picture; the browser is running already |
| pictures a second | while the mouse turns the view |
| full size | from the last move until the last picture, which is the one at full size |
| memory | highest resident memory of the server |
| growth | of the resident memory, while a page is loaded again every 10 s |
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from statistics import median

from tests.helpers.chromium import Chromium, Tab, chromium, wait_for

from rtgs.viewer.start import Viewer

WIDTH, HEIGHT, PANEL = 640, 480, 360
RELOAD_S = 10.0


class Server:
    """A viewer in a process of its own, which prints when it sent each picture and whether at full size.

    Attributes:
        url: where it is. started: when the process was.
    """

    def __init__(self, run: Path) -> None:
        self.started = time.time()
        command = [sys.executable, "-m", "benchmarks.viewer", str(run), "--serve"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()
        self._sent: list[tuple[float, bool]] = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            at, full = line.split()
            self._sent.append((float(at), full == "True"))

    @property
    def sent(self) -> list[tuple[float, bool]]:
        """When each picture was sent, and whether at full size."""
        return list(self._sent)

    def stop(self) -> None:
        self.process.terminate()
        self.process.wait()


def serve(run: Path) -> None:
    """The other side of `Server`."""
    viewer = Viewer(run, port=0)
    print(viewer.url, flush=True)
    latest = 0.0
    while True:
        time.sleep(0.005)
        for at, full in sorted(p for session in viewer.hub.sessions.values() for p in list(session.sent) if p[0] > latest):
            latest = at
            print(at, full, flush=True)


def memory_mb(server: Server, name: str) -> float:
    """`VmHWM` (highest) or `VmRSS` (now)."""
    lines = Path(f"/proc/{server.process.pid}/status").read_text().splitlines()
    return next(float(line.split()[1]) / 1024 for line in lines if line.startswith(name))


def open_page(browser: Chromium, server: Server) -> Tab:
    tab, before = browser.tab(WIDTH + PANEL, HEIGHT), len(server.sent)
    tab.call("Page.bringToFront")
    tab.go(server.url)
    wait_for(lambda: len(server.sent) > before, "there is a picture")
    return tab


def turn(tab: Tab, server: Server, seconds: float) -> tuple[float, float]:
    """Drags the view to and fro; gives the pictures a second, and the seconds from the last move to the picture at full size."""
    tab.mouse("mousePressed", WIDTH / 2, HEIGHT / 2, button="left", buttons=1, clickCount=1)
    started, k = time.time(), 0
    while time.time() - started < seconds:
        k += 1
        x = WIDTH / 2 + 40 * math.sin(k / 15)
        tab.mouse("mouseMoved", x, HEIGHT / 2, button="left", buttons=1)
    ended = time.time()
    rate = sum(started < at < ended for at, _ in server.sent) / (ended - started)
    tab.mouse("mouseReleased", x, HEIGHT / 2, button="left", clickCount=1)
    time.sleep(4.0)
    return rate, max(at for at, full in server.sent if full) - ended


def measure(run: Path, seconds: float, minutes: float) -> None:
    print(f"{run}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}", flush=True)
    with chromium() as browser:
        warm = Server(run)
        open_page(browser, warm).choose("Show", "Temperature")  # compiles what is not in the cache
        warm.stop()
        server = Server(run)
        try:
            tab = open_page(browser, server)
            print(f"first picture: {server.sent[0][0] - server.started:.1f} s", flush=True)
            for mode in ("RGB", "Temperature"):
                tab.choose("Show", mode)
                time.sleep(2.0)
                rates, waits = zip(*(turn(tab, server, seconds / 3) for _ in range(3)), strict=True)
                print(f"{mode}: {median(rates):.1f} pictures a second, full size after {median(waits):.2f} s of rest", flush=True)
            print(f"memory: {memory_mb(server, 'VmHWM'):.0f} MB", flush=True)
            reconnect(browser, server, minutes)
        finally:
            server.stop()


def reconnect(browser: Chromium, server: Server, minutes: float) -> None:
    """Load a page again and again, and compare the memory after the first minute with that at the end."""
    if minutes <= 0:
        return
    tab, begun, first, count = open_page(browser, server), time.time(), 0.0, 0
    while (gone := time.time() - begun) < 60 * minutes:
        time.sleep(RELOAD_S)
        tab.go(server.url)
        count += 1
        if not first and gone > 60:
            first = memory_mb(server, "VmRSS")
    wait_for(lambda: "Show" in tab.text(), "the page is there")
    last = memory_mb(server, "VmRSS")
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
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        serve(arguments.run)
    measure(arguments.run, arguments.seconds, arguments.reconnect_minutes)


if __name__ == "__main__":
    main()
