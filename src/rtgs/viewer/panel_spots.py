"""The tab "Spots": the list of hot and cold spots, a jump to each, and thresholds that are tried."""

from __future__ import annotations

import html

import numpy as np
import viser

from rtgs.base.errors import RtgsError
from rtgs.config import SpotsConfig
from rtgs.maths.geometry import look_at
from rtgs.records.metres import LengthUnit
from rtgs.records.spots import Spot
from rtgs.thermal.spots import find_spots
from rtgs.viewer.contents import with_spots
from rtgs.viewer.engine import Eye
from rtgs.viewer.panel_measure import unit_of
from rtgs.viewer.panel_view import Head
from rtgs.viewer.picture import Shade, difference_in_unit, from_unit, in_unit
from rtgs.viewer.pieces import block
from rtgs.viewer.session import Session, long_action, photo_eye

CRITERIA = ("by excess", "above", "below")
_LISTED = 12
_COLOURS = {"hot": (255, 80, 60), "cold": (80, 160, 255)}
_AWAY = 8.0  # spot diameters that a jump keeps away, where no photograph shows the spot


class SpotsPanel:
    """The tab "Spots"."""

    def __init__(self, session: Session, head: Head) -> None:
        self._session, self._head, gui = session, head, session.client.gui
        self._nodes: list[viser.SceneNodeHandle] = []
        with gui.add_folder("Find"):
            self._criterion = gui.add_dropdown("Criterion", CRITERIA, initial_value=CRITERIA[0])
            self._value = gui.add_number("Threshold", 3.0, step=0.5, hint="An excess over the surroundings, or a temperature.")
            self._find = gui.add_button("Find spots", icon="search")
            self._progress = gui.add_progress_bar(0.0, visible=False)
        with gui.add_folder("Spots"):
            self._list = gui.add_html("")
            self._choice = gui.add_dropdown("Spot", ("—",), initial_value="—")
            self._jump = gui.add_button("Jump to the spot", icon="focus-2")
            self._marks = gui.add_checkbox("Marks", True, hint="Of the spots, in the picture.")
        self._find.on_click(lambda _: session.safely(self._search))
        self._jump.on_click(lambda _: session.safely(self._go))
        self._marks.on_update(lambda _: session.safely(self._draw))
        self.refresh()

    def refresh(self) -> None:
        """After the list has changed."""
        found, unit = self._session.contents.spots, unit_of(self._session)
        names = ("—",) if found is None or not found.spots else tuple(_name(i, s, unit) for i, s in enumerate(found.spots))
        if tuple(self._choice.options) != names:
            self._choice.options = names
        if found is None:
            text = "No list yet. “Find spots” makes one from the training photographs."
        else:
            text = f"{len(found.spots)} spots: {found.criterion}"
        rows = "" if found is None else "".join(_row(i, s, unit, found.length_unit) for i, s in enumerate(found.spots[:_LISTED]))
        head = "<tr style='opacity:.7'><td>№</td><td>extreme</td><td>excess</td><td>ø</td><td>views</td></tr>" if rows else ""
        table = f'<table class="rtgs-spots" style="width:100%;font-size:12px;border-collapse:collapse">{head}{rows}</table>'
        self._list.content = block(html.escape(text) + (table if rows else ""))
        self._draw()

    def _search(self) -> None:
        session, contents = self._session, self._session.contents
        scene, thermal = contents.scene, contents.thermal
        if scene is None or thermal is None:
            raise RtgsError("Spots are found once there is a thermal model, with the capture at hand.")
        unit, value, kind = unit_of(session), float(self._value.value), self._criterion.value
        if kind == "by excess":
            config = SpotsConfig(excess=value / difference_in_unit(1.0, unit))
        elif kind == "above":
            config = SpotsConfig(above=from_unit(value, unit))
        else:
            config = SpotsConfig(below=from_unit(value, unit))
        engine = session.hub.engine
        with long_action(session, self._progress, self._find) as tell, engine.holding:
            told = engine.busy(lambda done, total, _: tell(done / max(total, 1)))
            per, length_unit = 1 / contents.sfm_per_unit, contents.length_unit
            found = find_spots(scene, thermal, config, unit_per_sfm=per, length_unit=length_unit, progress=told)
        session.hub.engine.contents = with_spots(session.contents, found)
        session.hub.refresh_all()

    def _go(self) -> None:
        """To the photograph that shows the spot largest, looking at the spot."""
        session, found = self._session, self._session.contents.spots
        at = next((i for i, name in enumerate(self._choice.options) if name == self._choice.value), 0)
        if found is None or at >= len(found.spots):
            session.say("No spot yet", "Find spots first.")
            return
        spot, contents = found.spots[at], session.contents
        place = contents.world(np.array(spot.position_m))
        if session.wish.mode in ("Photo and render", "Scale check", "RGB"):
            self._head.show("Temperature")
        frame = next((f for f in spot.best_frames if contents.scene is not None and f in contents.scene.world_from_rgb), None)
        if frame is None or contents.scene is None or contents.scale is None:
            eye = place + _AWAY * max(spot.diameter_m, 1e-3) * contents.world_per_unit * contents.up
            session.fly_to(Eye.of(640, 480, 0.8, look_at(eye, place, up=(0.3, 0.9, 0.3))), float(np.linalg.norm(eye - place)))
            return
        photo = photo_eye(contents.scene, frame, "thermal", contents.scale.sfm_per_metre)
        pose = photo.world_from_camera
        facing = look_at(pose.translation, place, up=-pose.rotation[:, 1])
        session.fly_to(Eye(photo.camera, facing), float(np.linalg.norm(place - pose.translation)))

    def _draw(self) -> None:
        session, found = self._session, self._session.contents.spots
        for node in self._nodes:
            node.remove()
        self._nodes.clear()
        if found is None or not found.spots or not self._marks.value:
            return
        contents, unit = session.contents, unit_of(session)
        for i, spot in enumerate(found.spots):
            place = contents.world(np.array(spot.position_m))
            text = f"{i + 1}: {in_unit(spot.extreme, unit):.1f} {unit}"
            self._nodes.append(session.client.scene.add_label(f"/spots/{i}", text, position=place, anchor="center-left"))


def _name(index: int, spot: Spot, unit: Shade) -> str:
    return f"{index + 1}: {spot.kind}, {in_unit(spot.extreme, unit):.1f} {unit}"


def _row(index: int, spot: Spot, unit: Shade, length_unit: LengthUnit) -> str:
    colour = "rgb" + str(_COLOURS[spot.kind])
    cells = (
        f'<b style="color:{colour}">{index + 1}</b>',
        f"{in_unit(spot.extreme, unit):.1f} {unit}",
        f"{difference_in_unit(spot.excess, unit):+.1f}",
        f"{100 * spot.diameter_m:.1f} cm" if length_unit == "m" else f"{spot.diameter_m:.2g} {length_unit}",
        str(spot.views),
    )
    return "<tr>" + "".join(f"<td style='padding:1px 6px 1px 0'>{cell}</td>" for cell in cells) + "</tr>"
