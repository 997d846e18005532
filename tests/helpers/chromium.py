"""A headless Chromium, driven through its DevTools protocol: no more than the tests of the viewer need."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import pytest
from websockets.sync.client import ClientConnection, connect

T = TypeVar("T")
PATIENCE_S = 180.0  # until a condition has to hold; the machine may be busy with other things
BROWSER = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)
needs_chromium = pytest.mark.skipif(
    BROWSER is None, reason="no Chromium is installed (chromium, chromium-browser or google-chrome)"
)
FLAGS = (
    *("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--hide-scrollbars"),
    *("--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--disable-dev-shm-usage", "--remote-debugging-port=0", "--force-device-scale-factor=1", "--disable-extensions"),
)


def wait_for(condition: Callable[[], T], what: str, patience_s: float = PATIENCE_S) -> T:
    """The first true value of the condition."""
    deadline = time.monotonic() + patience_s
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > deadline:
            raise AssertionError(f"waited {patience_s:.0f} s in vain until {what}")
        time.sleep(0.05)


class Tab:
    """A page in the browser.

    Attributes:
        errors: what the page wrote to its console as an error, and exceptions that nothing caught.
        requests: addresses that it asked for.
    """

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._number = socket, 0
        self.errors: list[str] = []
        self.requests: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A command of the protocol, and its result."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=PATIENCE_S))
            if message.get("id") == self._number:
                assert "error" not in message, (method, message["error"])
                return dict(message.get("result", {}))
            self._heard(message)

    def _heard(self, message: dict[str, Any]) -> None:
        method, told = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.errors.append(str(told["exceptionDetails"].get("exception", told["exceptionDetails"])))
        elif method == "Runtime.consoleAPICalled" and told["type"] in ("error", "assert"):
            self.errors.append(" ".join(str(a.get("value", a.get("description"))) for a in told["args"]))
        elif method == "Log.entryAdded" and told["entry"]["level"] == "error":
            self.errors.append(f"{told['entry']['text']} {told['entry'].get('url', '')}")
        elif method == "Network.requestWillBeSent":
            self.requests.append(told["request"]["url"])

    def go(self, url: str) -> None:
        self.call("Page.navigate", url=url)

    def js(self, expression: str) -> Any:
        """The value of an expression in the page."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, (expression, result["exceptionDetails"])
        return result["result"].get("value")

    def resize(self, width: int, height: int) -> None:
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def screenshot(self) -> np.ndarray:
        """`[H, W, 3]`."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))[..., ::-1]

    def click(self, x: float, y: float) -> None:
        self.mouse("mouseMoved", x, y)
        self.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
        self.mouse("mouseReleased", x, y, button="left", clickCount=1)

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 8) -> None:
        self.mouse("mouseMoved", *start)
        self.mouse("mousePressed", *start, button="left", buttons=1, clickCount=1)
        for k in range(1, steps + 1):
            x, y = (a + k / steps * (b - a) for a, b in zip(start, end, strict=True))
            self.mouse("mouseMoved", x, y, button="left", buttons=1)
        self.mouse("mouseReleased", *end, button="left", clickCount=1)

    def key(self, name: str, code: int) -> None:
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=name, code=name, windowsVirtualKeyCode=code)

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """An event of the mouse: "mousePressed", "mouseMoved" or "mouseReleased"."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    # What a person finds by its text

    def text(self) -> str:
        """All text of the page."""
        return str(self.js("(document.body || {}).innerText || ''"))

    def place_of(self, finder: str) -> tuple[float, float, float, float] | None:
        """Left, top, width and height of the element that the expression finds, scrolled into view; None where there is none."""
        found = self.js(
            f"(() => {{ const e = {finder}; if (!e) return null; e.scrollIntoView({{block: 'center'}});"
            " const r = e.getBoundingClientRect(); return [r.left, r.top, r.width, r.height]; })()"
        )
        return None if found is None else (found[0], found[1], found[2], found[3])

    def press(self, finder: str, what: str, patience_s: float = PATIENCE_S) -> None:
        """Click the middle of the element that the expression finds, once it is there, lies still and is covered by nothing."""
        self.call("Page.bringToFront")  # a browser does not draw what is behind
        seen: list[tuple[float, float, float, float] | None] = [None]

        def still() -> tuple[float, float, float, float] | None:
            before, seen[0] = seen[0], self.place_of(finder)
            place = seen[0]
            if place is None or place != before or not (place[2] > 0 and place[3] > 0):
                return None
            x, y = place[0] + place[2] / 2, place[1] + place[3] / 2
            both = f"const a = {finder}, b = document.elementFromPoint({x}, {y})"
            on_top = self.js(f"(() => {{ {both}; return !!a && !!b && (a.contains(b) || b.contains(a)); }})()")
            return place if on_top else None

        place = wait_for(still, f"{what} is on the page", patience_s)
        assert place is not None
        left, top, width, height = place
        self.click(left + width / 2, top + height / 2)

    def press_button(self, text: str) -> None:
        self.press(_first("button", text), f"the button {text!r}")

    def open_tab(self, text: str) -> None:
        finder = _first("[role=tab]", text)

        def opened() -> bool:
            if self.js(f"(({finder}) || document.body).getAttribute('aria-selected')") == "true":
                return True
            self.press(finder, f"the tab {text!r}")
            return False

        wait_for(opened, f"the tab {text!r} is open")

    def choose(self, label: str, option: str) -> None:
        """An option of a drop-down list. A page that is being built may lose a click, so the list is opened until the option is chosen."""
        finder = _first("[role=option]", option)

        def chosen() -> bool:
            if self.value_of(label) == option:
                return True
            self.press(_input(label), f"the list {label!r}")
            with contextlib.suppress(AssertionError):
                wait_for(lambda: self.place_of(finder), f"the list {label!r} is open", patience_s=5.0)
                self.press(finder, f"the option {option!r}", patience_s=5.0)
            return self.value_of(label) == option

        wait_for(chosen, f"{option!r} is chosen in {label!r}")

    def tick(self, label: str) -> None:
        """A box to tick, on or off."""
        self.press(_input(label), f"the box {label!r}")

    def fill(self, label: str, value: str) -> None:
        """Type a value into a control, in place of what it holds."""
        self.press(_input(label), f"the control {label!r}")
        self.js(f"({_input(label)}).select()")
        self.call("Input.insertText", text=value)
        self.key("Enter", 13)

    def html_of(self, selector: str) -> str:
        """Text of the first element that can be seen; "" where there is none."""
        found = f"[...document.querySelectorAll({json.dumps(selector)})].find(e => e.offsetParent)"
        return str(self.js(f"(({found}) || {{innerText: ''}}).innerText"))

    def value_of(self, label: str) -> str:
        """What a control shows."""
        return str(self.js(f"(({_input(label)}) || {{value: ''}}).value"))


def _first(selector: str, text: str) -> str:
    """An element of exactly this text that can be seen."""
    return f"[...document.querySelectorAll({json.dumps(selector)})].find(e => e.innerText.trim() === {json.dumps(text)} && e.offsetParent)"


def _input(label: str) -> str:
    """The input that belongs to a label."""
    named = f"e.innerText.trim() === {json.dumps(label)} && e.offsetParent"
    return (
        f"(() => {{ const l = [...document.querySelectorAll('label')].find(e => {named}); if (!l) return null;"
        " const e = document.getElementById(l.htmlFor); if (e && e.tagName === 'INPUT') return e;"
        " return l.parentElement.parentElement.querySelector('input:not([type=hidden])'); })()"
    )


class Chromium:
    """A browser, with tabs."""

    def __init__(self, port: int, folder: Path) -> None:
        self._port, self.folder = port, folder
        self._sockets: list[ClientConnection] = []
        version = self._get("/json/version")
        # No pings: a browser that draws on a busy machine answers late, and is well.
        self._main = connect(version["webSocketDebuggerUrl"], max_size=None, ping_interval=None, open_timeout=PATIENCE_S)
        self._sockets.append(self._main)

    def _get(self, path: str) -> dict[str, Any]:
        with urllib.request.urlopen(f"http://127.0.0.1:{self._port}{path}", timeout=PATIENCE_S) as answer:
            return dict(json.load(answer))

    def tab(self, width: int = 1000, height: int = 700) -> Tab:
        self._main.send(json.dumps({"id": 1, "method": "Target.createTarget", "params": {"url": "about:blank"}}))
        target = ""
        while not target:
            message = json.loads(self._main.recv(timeout=PATIENCE_S))
            target = message.get("result", {}).get("targetId", "") if message.get("id") == 1 else ""
        socket = connect(
            f"ws://127.0.0.1:{self._port}/devtools/page/{target}", max_size=None, ping_interval=None, open_timeout=PATIENCE_S
        )
        self._sockets.append(socket)
        tab = Tab(socket)
        tab.resize(width, height)
        tab.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(self.folder))
        return tab

    def close(self) -> None:
        for socket in self._sockets:
            with contextlib.suppress(Exception):
                socket.close()


@contextlib.contextmanager
def chromium() -> Iterator[Chromium]:
    """A browser of its own; its process and its files are gone afterwards."""
    assert BROWSER is not None
    with tempfile.TemporaryDirectory(prefix="rtgs-chromium-", ignore_cleanup_errors=True) as folder:
        process = subprocess.Popen(
            [BROWSER, *FLAGS, f"--user-data-dir={folder}/profile", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        browser = None
        try:
            file = Path(folder) / "profile" / "DevToolsActivePort"
            lines = wait_for(lambda: file.read_text().splitlines() if file.exists() else [], "Chromium has started")
            browser = Chromium(int(lines[0]), Path(folder) / "downloads")
            yield browser
        finally:
            if browser is not None:
                browser.close()
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
