"""A tab that shows the viewer of the wall, for tests that act as a person does."""

from __future__ import annotations

import threading

import cv2
import numpy as np
from tests.helpers.chromium import Chromium, Tab, wait_for
from tests.helpers.viewed_wall import TRUTH
from tests.helpers.wall_scene import PLANE_M

from rtgs.maths.geometry import SE3
from rtgs.viewer.engine import Eye
from rtgs.viewer.session import Session
from rtgs.viewer.start import Viewer

WIDTH, HEIGHT = 900, 640
NOTICES = "[...document.querySelectorAll('.mantine-Notification-root')].some(e => e.getClientRects().length)"


class Visit:
    """A tab that shows the viewer, and the session that serves it."""

    def __init__(self, browser: Chromium, viewer: Viewer) -> None:
        known = set(viewer.hub.sessions)
        self.tab: Tab = browser.tab(WIDTH, HEIGHT)
        self.tab.call("Page.bringToFront")
        self.tab.go(viewer.url)
        found = wait_for(
            lambda: next((s for k, s in viewer.hub.sessions.items() if k not in known), None), "the browser has come"
        )
        assert found is not None
        self.session: Session = found
        wait_for(lambda: "Measure" in self.tab.text(), "the panel is there")
        self.at_rest()

    def at_rest(self) -> None:
        """The picture on the screen is that of the wish and of the camera, at full size."""
        wait_for(lambda: self.session.settled, "the picture is drawn")

    def canvas(self) -> tuple[float, float, float, float]:
        found = self.tab.place_of("document.querySelector('canvas')")
        assert found is not None
        return found

    def knows_the_canvas(self) -> bool:
        """A panel that opens takes room from the canvas, and the session hears of it later."""
        _, _, width, height = self.canvas()
        camera = self.session.eye().camera
        return abs(camera.width / camera.height * height / width - 1) < 0.01

    def look_from(self, position_m: tuple[float, float, float]) -> None:
        """Put the browser's camera there, facing the wall, and wait until the browser says that it is."""
        pose = self.session.contents.given_from_world.carry_inverse(SE3(np.eye(3), TRUTH * np.array(position_m)))
        eye, said = Eye.of(640, 480, 0.7, pose), threading.Event()

        def there() -> bool:
            return np.allclose(self.session.eye().world_from_camera.matrix(), pose.matrix(), atol=1e-3)

        if not there():
            # The server's own numbers change at once. What the browser reports follows when it has moved.
            self.session.client.camera.on_update(lambda _: said.set() if there() else None)
            self.session.fly_to(eye, TRUTH * (PLANE_M - position_m[2]))
            wait_for(said.is_set, "the browser's camera is there")
        self.at_rest()

    def pixel_of(self, position_m: tuple[float, float, float]) -> tuple[float, float]:
        """Where a place of the run is on the page."""
        wait_for(self.knows_the_canvas, "the session knows the canvas's shape")
        left, top, width, height = self.canvas()
        eye = self.session.eye()
        place = eye.world_from_camera.inverse().apply(self.session.contents.world(np.array(position_m)))
        x, y = eye.camera.project(place)
        return left + float(x) / eye.camera.width * width, top + float(y) / eye.camera.height * height

    def click_at(self, position_m: tuple[float, float, float]) -> None:
        before = self.tab.html_of(".rtgs-reading")
        self.tab.click(*self.pixel_of(position_m))
        wait_for(lambda: self.tab.html_of(".rtgs-reading") not in ("", before), "there is another reading")

    def picture(self) -> np.ndarray:
        """What the page shows of the model."""
        left, top, width, height = (int(v) for v in self.canvas())
        return self.tab.screenshot()[top : top + height, left : left + width]

    def model(self) -> np.ndarray:
        """As `picture`, once the page shows the session's latest picture, with nothing but labels before it."""

        found = self.picture()

        def there() -> bool:
            nonlocal found
            if not self.session.settled or self.session.shown is None or self.tab.js(NOTICES):
                return False
            found, sent = self.picture(), self.session.shown.picture
            wanted = cv2.resize(sent, (found.shape[1], found.shape[0]), interpolation=cv2.INTER_LINEAR)
            return bool(np.abs(found.astype(float) - wanted).mean() < 4)

        wait_for(there, "the page shows the latest picture")
        return found
