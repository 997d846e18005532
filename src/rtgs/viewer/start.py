"""Opens a run in a browser: the server, what all browsers share, and one page for each browser."""

from __future__ import annotations

import gc
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import viser

from rtgs.base.memory import release
from rtgs.maths.geometry import SE3, look_at
from rtgs.run.config_file import check_run
from rtgs.viewer.contents import Contents, read_contents
from rtgs.viewer.engine import Engine, Eye
from rtgs.viewer.guard import GuardedServer
from rtgs.viewer.panel_measure import MeasurePanel
from rtgs.viewer.panel_photos import PhotosPanel
from rtgs.viewer.panel_save import SavePanel
from rtgs.viewer.panel_scale import ScalePanel
from rtgs.viewer.panel_spots import SpotsPanel
from rtgs.viewer.panel_view import Head, ViewPanel
from rtgs.viewer.session import Session

POLL_S = 2.0
PANEL_PX = 340.0
NARROW_PX = 640  # a picture narrower than this beside the panel
NARROW_PANEL_PX = 280.0  # is given more room


class Page:
    """What one browser shows."""

    def __init__(self, hub: Hub, client: viser.ClientHandle) -> None:
        self.session = session = Session(hub, client)
        gui = client.gui
        if client.camera.image_width < NARROW_PX:
            gui.main_panel.set_width(NARROW_PANEL_PX)
        with client.atomic():
            self.head = Head(session)
            tabs = gui.add_tab_group()
            with tabs.add_tab("View"):
                view = ViewPanel(session, self.head)
            with tabs.add_tab("Measure"):
                measure = MeasurePanel(session)
            with tabs.add_tab("Photos"):
                photos = PhotosPanel(session, self.head)
            with tabs.add_tab("Spots"):
                spots = SpotsPanel(session, self.head)
            with tabs.add_tab("Scale"):
                scale = ScalePanel(session, self.head, photos)
            with tabs.add_tab("Save"):
                SavePanel(session)
        self._panels: list[Any] = [self.head, view, measure, photos, spots, scale]

    def refresh(self) -> None:
        """After the run, its spots or the views have changed."""
        for panel in self._panels:
            self.session.safely(panel.refresh)
        self.session.redraw()


class Hub:
    """What all browsers of a server share.

    Attributes:
        engine: renders for all. views: kept by a person, by name. name: of the run.
    """

    def __init__(self, run: Path, spots: Path | None = None) -> None:
        self.run, self._spots = run, spots
        self.engine = Engine(read_contents(run, spots))
        self.views: dict[str, Eye] = {}
        self.name = run.resolve().name
        self._pages: dict[int, Page] = {}
        self._lock = threading.Lock()
        self._gone = threading.Event()

    @property
    def sessions(self) -> dict[int, Session]:
        """Of the browsers that are here, by their number."""
        with self._lock:
            return {number: page.session for number, page in self._pages.items()}

    def open(self, client: viser.ClientHandle) -> None:
        """A browser has come."""
        page = Page(self, client)
        with self._lock:
            self._pages[client.client_id] = page
        page.session.start()

    def close(self, client: viser.ClientHandle) -> None:
        """A browser has gone."""
        with self._lock:
            page = self._pages.pop(client.client_id, None)
        if page is not None:
            page.session.close()
            self._gone.set()

    def tidy(self) -> None:
        """Give the memory of pages that were closed back to the system. Each would leave a megabyte in pieces otherwise."""
        if self._gone.is_set():
            self._gone.clear()
            gc.collect()
            release()

    def refresh_all(self) -> None:
        """Every page follows what has changed."""
        with self._lock:
            pages = list(self._pages.values())
        for page in pages:
            page.refresh()

    def poll(self) -> bool:
        """Read what has changed in the run folder since. Returns whether anything has."""
        before = self.engine.contents
        after = read_contents(self.run, self._spots, before)
        if after.marks == before.marks:
            return False
        self.engine.contents = after
        self.refresh_all()
        return True


class Viewer:
    """A run that is open in a browser; `stop` closes it. A notebook shows it in its cell.

    Attributes:
        url: where it is.
    """

    def __init__(self, run: Path, *, host: str = "127.0.0.1", port: int = 8080, spots: Path | None = None) -> None:
        check_run(run)
        self.hub = Hub(run, spots)
        self.server = GuardedServer(host, port, f"rtgs · {self.hub.name}")
        self.server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="large")
        self.server.gui.main_panel.dock_right()
        self.server.gui.main_panel.set_width(PANEL_PX)
        self._begin_at(self.hub.engine.contents)
        self.server.on_client_connect(self.hub.open)
        self.server.on_client_disconnect(self.hub.close)
        self._stopped = threading.Event()
        self._poller = threading.Thread(target=self._poll, name="viewer poll", daemon=True)
        self._poller.start()

    @property
    def url(self) -> str:
        return self.server.url

    def stop(self) -> None:
        """Close the server and all pages."""
        self._stopped.set()
        self.server.stop()

    def wait(self) -> None:
        """Until somebody stops it, or this process is interrupted."""
        while not self._stopped.wait(3600.0):
            pass

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" width="100%" height="640" style="border:0"></iframe>'

    def _begin_at(self, contents: Contents) -> None:
        """New browsers begin at the first photograph, or above the model."""
        camera = self.server.initial_camera
        self.server.scene.set_up_direction(tuple(contents.up.tolist()))
        lo, hi = contents.box
        middle, size = 0.5 * (lo + hi), float(np.linalg.norm(hi - lo))
        if contents.scene is not None and contents.scene.world_from_rgb:
            pose, rgb = next(iter(contents.scene.world_from_rgb.values())), contents.scene.rig.rgb
            found = self.hub.engine.distance(Eye(rgb, pose), rgb.cx, rgb.cy)
            distance, fov = found if np.isfinite(found) else 0.5 * size, 2 * np.arctan(0.5 * rgb.height / rgb.fl_y)
        else:
            aside = np.array([1.0, 0.3, 0.0]) if abs(contents.up[0]) < 0.9 else np.array([0.0, 1.0, 0.3])
            eye = middle + size * (0.8 * aside + 0.5 * contents.up)
            pose, distance, fov = look_at(eye, middle, up=contents.up), float(np.linalg.norm(eye - middle)), 0.9
        _place(camera, pose, distance, float(fov))

    def _poll(self) -> None:
        known = self.hub.engine.contents.scene is not None
        while not self._stopped.wait(POLL_S):
            self.hub.tidy()
            try:
                if self.hub.poll() and not known and self.hub.engine.contents.scene is not None:
                    known = True
                    self._begin_at(self.hub.engine.contents)
            except Exception as error:  # the viewer goes on whatever a run folder holds
                print(f"viewer: the run folder cannot be read now: {error}", flush=True)
                time.sleep(POLL_S)


def _place(camera: viser.InitialCameraConfig, pose: SE3, distance: float, fov: float) -> None:
    position, target = pose.translation, pose.translation + distance * pose.rotation[:, 2]
    camera.position, camera.look_at, camera.fov = position, target, fov


def view(run: Path | str, *, host: str = "127.0.0.1", port: int = 8080, spots: Path | str | None = None) -> Viewer:
    """Open a run in a browser, and go on. In a notebook the last expression of a cell shows it there.

    Args:
        run: the run folder; it may be half finished, or a run may be going on in it.
        host: address to bind to. Others than 127.0.0.1 let other machines in.
        port: 0 for any free one; the next free one where it is taken.
        spots: `spots.json` of `rtgs spots`, to show in place of the run's own list.

    Returns:
        The server; `stop` closes it.

    Raises:
        RtgsError: there is no such folder, or the address cannot be bound.
    """
    return Viewer(Path(run), host=host, port=port, spots=None if spots is None else Path(spots))
