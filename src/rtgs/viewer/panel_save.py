"""The tab "Save": a picture, or a film, of what is shown."""

from __future__ import annotations

import numpy as np

from rtgs.images.pictures import Picture, with_colour_bar
from rtgs.viewer.engine import Eye
from rtgs.viewer.movie import FRAMES_PER_S, film, path, turntable
from rtgs.viewer.panel_measure import unit_of
from rtgs.viewer.picture import in_unit
from rtgs.viewer.scale_check import png
from rtgs.viewer.session import Session, Shown, long_action

_FILM_PX = 960  # of its longer side


class SavePanel:
    """The tab "Save"."""

    def __init__(self, session: Session) -> None:
        self._session, gui = session, session.client.gui
        with gui.add_folder("Picture"):
            self._bar = gui.add_checkbox("Colour bar", True, hint="Beside the picture.")
            self._shot = gui.add_button("Save the picture", icon="photo")
        with gui.add_folder("Film"):
            self._seconds = gui.add_number("Seconds", 6, min=1, max=120, step=1)
            self._turn = gui.add_button("Save a turntable", icon="rotate-360")
            self._path = gui.add_button("Save a path through the views", icon="route")
            self._progress = gui.add_progress_bar(0.0, visible=False)
        self._shot.on_click(lambda _: session.safely(self._picture))
        self._turn.on_click(lambda _: session.safely(self._turntable))
        self._path.on_click(lambda _: session.safely(self._through_views))

    def _picture(self) -> None:
        session = self._session
        shown = session.painter.draw(session.wish, session.eye())
        name = session.wish.mode.lower().replace(" ", "-")
        session.client.send_file_download(f"{session.hub.name}-{name}.png", png(self._dressed(shown)), save_immediately=True)

    def _dressed(self, shown: Shown) -> Picture:
        """With the colour bar, where temperatures are shown."""
        session = self._session
        if not self._bar.value or session.wish.mode in ("RGB", "Scale check") or session.contents.thermal is None:
            return shown.picture
        look, unit = shown.look, unit_of(session)
        return with_colour_bar(shown.picture, in_unit(look.lo, unit), in_unit(look.hi, unit), unit, look.palette)

    def _turntable(self) -> None:
        session, eye = self._session, self._session.eye()
        distance = session.hub.engine.distance(eye, eye.camera.width / 2, eye.camera.height / 2)
        pose = eye.world_from_camera
        lo, hi = session.contents.box
        centre = pose.translation + distance * pose.rotation[:, 2] if np.isfinite(distance) else 0.5 * (lo + hi)
        self._film(turntable(eye, centre, np.asarray(session.client.camera.up_direction), self._count), "turntable")

    def _through_views(self) -> None:
        session = self._session
        self._film(path(list(session.hub.views.values()), self._count), "path")

    @property
    def _count(self) -> int:
        return max(2, round(float(self._seconds.value) * FRAMES_PER_S))

    def _film(self, eyes: list[Eye], kind: str) -> None:
        session, wish = self._session, self._session.wish
        factor = _FILM_PX / max(eyes[0].camera.width, eyes[0].camera.height)
        width, height = (max(2, round(n * min(factor, 1.0))) for n in (eyes[0].camera.width, eyes[0].camera.height))
        painter = type(session.painter)(session.hub.engine)

        with long_action(session, self._progress, self._turn, self._path) as tell:
            content = film(eyes, lambda eye: painter.draw(wish, eye.resized(width, height)).picture, tell)
        session.client.send_file_download(f"{session.hub.name}-{kind}.mp4", content, save_immediately=True)
