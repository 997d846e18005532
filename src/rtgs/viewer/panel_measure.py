"""The tab "Measure": what is known where a person clicks, and lengths between clicks."""

from __future__ import annotations

import html

import numpy as np
import viser

from rtgs.base.errors import RtgsError
from rtgs.viewer.picture import Shade, difference_in_unit, in_unit
from rtgs.viewer.pieces import hint, table
from rtgs.viewer.probe import Reading, probe
from rtgs.viewer.ruler import FEWEST, KINDS, Kind, Measured, measure
from rtgs.viewer.session import Session

TOOLS = ("probe", *KINDS)
_COLOUR = (64, 224, 128)
_SHOWN = 3  # photographs of a reading


class MeasurePanel:
    """The tab "Measure". Every click is a reading; the chosen tool says what else the points are for."""

    def __init__(self, session: Session) -> None:
        self._session, gui = session, session.client.gui
        self._points: list[np.ndarray] = []
        self._nodes: list[viser.SceneNodeHandle] = []
        self._reading: Reading | None = None
        self._tool = gui.add_dropdown("Tool", TOOLS, initial_value="probe", hint="Then click into the picture.")
        with gui.add_folder("At the click"):
            self._text = gui.add_html(hint("Click into the picture."))
        with gui.add_folder("Between clicks"):
            self._result = gui.add_html(hint("Choose a tool: distance, polyline, area or height above a plane."))
            undo = gui.add_button("Remove the last point", icon="arrow-back-up")
            clear = gui.add_button("Remove all points", icon="trash")
        self._tool.on_update(lambda _: session.safely(self.clear))
        undo.on_click(lambda _: session.safely(self._undo))
        clear.on_click(lambda _: session.safely(self.clear))
        session.client.scene.on_click()(lambda event: session.safely(lambda: self._clicked(event.screen_pos)))

    def refresh(self) -> None:
        """After the run has changed: points keep their places in the world, and their numbers are those of the new scale."""
        self._measure()

    def write(self) -> None:
        """The reading again, in another unit."""
        if self._reading is not None:
            self._text.content = reading_html(self._reading, self._session)

    def clear(self) -> None:
        self._points.clear()
        self._measure()

    def _undo(self) -> None:
        if self._points:
            self._points.pop()
        self._measure()

    def _clicked(self, place: tuple[float, float]) -> None:
        session = self._session
        found = None if session.shown is None else session.shown.at(*place)
        if found is None:
            return
        self._text.content = hint("Looking …")
        self._reading = probe(session.hub.engine, *found)
        if self._reading is None:
            self._text.content = hint("The model shows no surface there.")
            return
        self.write()
        if self._tool.value == "probe":
            self._points[:] = [self._reading.world]
        else:
            self._points.append(self._reading.world)
        self._measure()

    def _measure(self) -> None:
        """The result of the chosen tool, and its points in the picture."""
        tool, result = self._tool.value, None
        if tool != "probe":
            kind: Kind = tool
            needed = FEWEST[kind]
            if len(self._points) < needed:
                more = needed - len(self._points)
                self._result.content = hint(f"{tool}: {more} more {'point' if more == 1 else 'points'}.")
            else:
                try:
                    result = measure(kind, np.array(self._points), self._session.contents)
                    self._result.content = measured_html(result)
                except RtgsError as error:
                    self._result.content = hint(str(error))
        self._draw(result)

    def _draw(self, result: Measured | None) -> None:
        scene = self._session.client.scene
        for node in self._nodes:
            node.remove()
        self._nodes.clear()
        if not self._points:
            return
        points = np.array(self._points, np.float32)
        lo, hi = self._session.contents.box
        size = 0.004 * float(np.linalg.norm(hi - lo))
        colours = np.tile(np.array(_COLOUR, np.uint8), (len(points), 1))
        self._nodes.append(
            scene.add_point_cloud("/measure/points", points, colours, point_size=size, point_shape="circle", precision="float32")
        )
        order = [*range(len(points)), *([0] if self._tool.value == "area" and len(points) > 2 else [])]
        if len(order) > 1:
            ends = np.stack([points[order[:-1]], points[order[1:]]], axis=1)
            self._nodes.append(scene.add_line_segments("/measure/lines", ends, _COLOUR, thickness=0.4 * size))
        text = str(result).split(" (")[0] if result is not None else self._label()
        if text:
            self._nodes.append(
                scene.add_label("/measure/label", text, position=points[-1], anchor="bottom-center", font_screen_scale=1.2)
            )

    def _label(self) -> str:
        reading, session = self._reading, self._session
        if reading is None or reading.temperature is None or self._tool.value != "probe":
            return ""
        unit = unit_of(session)
        return f"{in_unit(reading.temperature, unit):.1f} {unit}"


def unit_of(session: Session) -> Shade:
    """The unit that temperatures are shown in."""
    thermal = session.contents.thermal
    return "counts" if thermal is not None and thermal.unit == "counts" else session.wish.unit


def reading_html(reading: Reading, session: Session) -> str:
    """A reading as a table."""
    unit, length = unit_of(session), session.contents.length_unit
    rows: list[tuple[str, str]] = []
    if reading.temperature is not None:
        value = f"<b>{in_unit(reading.temperature, unit):.2f} {unit}</b>"
        if reading.std is not None:
            value += f" ± {difference_in_unit(reading.std, unit):.2f}"
        rows.append(("Model", value))
    if reading.photographed is not None:
        values = [p.steady for p in reading.photographs]
        low, high = (in_unit(v, unit) for v in (min(values), max(values)))
        rows.append(("Photographs", f"{in_unit(reading.photographed, unit):.2f} {unit} ({low:.2f} … {high:.2f})"))
    rows.append(("Seen by", f"{reading.views} thermal {'photograph' if reading.views == 1 else 'photographs'}"))
    rows += [
        (f"&nbsp;&nbsp;{html.escape(p.frame)}", f"{in_unit(p.value, unit):.2f} {unit}") for p in reading.photographs[:_SHOWN]
    ]
    rows.append(("Depth", f"{reading.depth:.3f} {length}"))
    rows.append(("Position", ", ".join(f"{v:.3f}" for v in reading.position) + f" {length}"))
    return table(rows, "rtgs-reading")


def measured_html(result: Measured) -> str:
    """A measured number as a table."""
    rows = [(result.kind.capitalize(), f"<b>{result.value:.4g} {result.unit}</b>")]
    if result.low is not None and result.high is not None:
        rows.append(("95 % interval", f"{result.low:.4g} … {result.high:.4g} {result.unit}"))
    if result.note:
        rows.append(("Note", html.escape(result.note)))
    return table(rows, "rtgs-measured")
