"""The page's head and its tab "View": what is shown, palette, range, isotherm, clip box, up axis, named views."""

from __future__ import annotations

import html

import numpy as np

from rtgs.viewer.engine import Clip, Eye
from rtgs.viewer.legend import colour_bar
from rtgs.viewer.picture import PALETTES, SHOWS, Shade, from_unit, in_unit, percentiles
from rtgs.viewer.pieces import STYLE
from rtgs.viewer.session import MODES, RANGES, Session, Shown

UPS = ("as photographed", "+x", "−x", "+y", "−y", "+z", "−z")


class Head:
    """What stays in sight: what is shown, the colour bar, and what is missing."""

    def __init__(self, session: Session) -> None:
        self._session, gui = session, session.client.gui
        gui.add_html(STYLE)
        self.message = gui.add_markdown("", visible=False)
        self.mode = gui.add_dropdown("Show", MODES, initial_value=session.wish.mode)
        self.legend = gui.add_html("", visible=False)
        self.note = gui.add_markdown("", visible=False)
        self._drawn = ""
        self.mode.on_update(lambda _: session.safely(lambda: self._changed(self.mode.value)))
        session.after_drawing.append(self._follow)
        self.refresh()

    def show(self, mode: str) -> None:
        """Choose a mode as if a person had."""
        if self.mode.value != mode:
            self.mode.value = mode
        self._changed(mode)

    def refresh(self) -> None:
        """After the run has changed."""
        messages = self._session.contents.messages
        self.message.content = "\n\n".join(f"⚠ {_plain(text)}" for text in messages.values())
        self.message.visible = bool(messages)

    def _changed(self, mode: str) -> None:
        session = self._session
        if session.wish.mode != mode:
            session.client.scene.set_global_visibility(mode in SHOWS and mode != "Side by side")
            session.ask(mode=mode)

    def _follow(self, shown: Shown) -> None:
        session = self._session
        thermal = session.contents.thermal
        warm = thermal is not None and (
            session.wish.mode in ("Temperature", "Blend", "Side by side")
            or (session.wish.mode == "Photo and render" and session.wish.sensor == "thermal")
        )
        unit: Shade = "counts" if thermal is not None and thermal.unit == "counts" else session.wish.unit
        content = colour_bar(shown.look, unit) if warm else ""
        if content != self._drawn:
            self._drawn, self.legend.content, self.legend.visible = content, content, bool(content)
        if self.note.content != shown.note:
            self.note.content, self.note.visible = shown.note, bool(shown.note)


def _plain(text: str) -> str:
    """Text in which Markdown finds nothing."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]()#+-.!|<>" else c for c in html.unescape(text))


class ViewPanel:
    """The tab "View"."""

    def __init__(self, session: Session, head: Head) -> None:
        self._session, self._head = session, head
        self._temperatures()
        self._clip_box()
        self._camera()

    def refresh(self) -> None:
        """After the run has changed."""
        thermal = self._session.contents.thermal
        if thermal is not None and self._low.value == self._high.value:
            self._low.value, self._high.value = (
                round(in_unit(v, self._unit_now), 2) for v in (thermal.range.lo, thermal.range.hi)
            )
        self._names()

    @property
    def _unit_now(self) -> Shade:
        thermal = self._session.contents.thermal
        return "counts" if thermal is not None and thermal.unit == "counts" else self._session.wish.unit

    def _temperatures(self) -> None:
        session, gui = self._session, self._session.client.gui
        thermal = session.contents.thermal
        lo, hi = (0.0, 0.0) if thermal is None else (round(thermal.range.lo, 2), round(thermal.range.hi, 2))
        self._banded = False
        with gui.add_folder("Temperatures"):
            self._blend = gui.add_slider("Blend", 0.0, 1.0, 0.05, 0.5, hint="Share of the temperature in the mode Blend.")
            self._palette = gui.add_dropdown("Palette", tuple(PALETTES), initial_value="Inferno")
            self._unit = gui.add_dropdown("Unit", ("°C", "°F", "K"), initial_value="°C")
            self._kind = gui.add_dropdown("Range", RANGES, initial_value=RANGES[0])
            self._percent = gui.add_multi_slider("Percentiles", 0.0, 100.0, 0.5, (2.0, 98.0), visible=False)
            self._low = gui.add_number("Lowest", lo, step=0.1, visible=False)
            self._high = gui.add_number("Highest", hi, step=0.1, visible=False)
            self._isotherm = gui.add_checkbox("Isotherm", False, hint="Paint a band of temperatures green.")
            self._from = gui.add_number("From", 0.0, step=0.1, visible=False)
            self._to = gui.add_number("To", 0.0, step=0.1, visible=False)
        for control in (
            self._blend,
            self._palette,
            self._kind,
            self._percent,
            self._low,
            self._high,
            self._isotherm,
            self._from,
            self._to,
        ):
            control.on_update(lambda _: session.safely(self._take))
        self._unit.on_update(lambda _: session.safely(self._change_unit))

    def _take(self) -> None:
        session, unit = self._session, self._unit_now
        kind, band = self._kind.value, self._isotherm.value
        self._percent.visible = kind == RANGES[1]
        self._low.visible = self._high.visible = kind == RANGES[2]
        self._from.visible = self._to.visible = band
        if kind == RANGES[2] != session.wish.range_kind and session.shown is not None:  # begins with the colours that are there
            self._low.value, self._high.value = (
                round(in_unit(end, unit), 2) for end in (session.shown.look.lo, session.shown.look.hi)
            )
        if band and not self._banded:
            self._banded = True
            for handle, end in zip((self._from, self._to), self._warmest(), strict=True):
                handle.value = round(in_unit(end, unit), 1)
        low, high, start, end = (from_unit(h.value, unit) for h in (self._low, self._high, self._from, self._to))
        session.ask(
            blend=self._blend.value,
            palette=PALETTES[self._palette.value],
            range_kind=kind,
            percentiles=(self._percent.value[0], self._percent.value[1]),
            by_hand=(min(low, high), max(low, high)),
            isotherm=(min(start, end), max(start, end)) if band else None,
        )

    def _warmest(self) -> tuple[float, float]:
        """The range of the warmest tenth of the picture: the first isotherm."""
        session, shown = self._session, self._session.shown
        seen = None if shown is None or shown.seen is None else shown.seen.temperature
        look = session.painter.look_of(session.wish, seen)
        return (None if seen is None else percentiles(seen, 90.0, 100.0)) or (0.5 * (look.lo + look.hi), look.hi)

    def _change_unit(self) -> None:
        """The same temperatures in another unit."""
        session, before = self._session, self._unit_now
        handles = (self._low, self._high, self._from, self._to)
        kept = [from_unit(handle.value, before) for handle in handles]
        session.ask(unit=self._unit.value)
        for handle, value in zip(handles, kept, strict=True):
            handle.value = round(in_unit(value, self._unit_now), 2)

    def _clip_box(self) -> None:
        session, gui = self._session, self._session.client.gui
        with gui.add_folder("Clip box", expand_by_default=False):
            self._clip = gui.add_checkbox("Clip", False, hint="Show only what lies inside of a box.")
            self._sides = [gui.add_multi_slider(f"{axis}, %", -5.0, 105.0, 1.0, (-5.0, 105.0)) for axis in "xyz"]
        for control in (self._clip, *self._sides):
            control.on_update(lambda _: session.safely(self._take_clip))

    def _take_clip(self) -> None:
        lo, hi = self._session.contents.box
        ends = np.array([side.value for side in self._sides]) / 100.0
        # An end beyond the box, which holds nearly everything, cuts nothing.
        low = np.where(ends[:, 0] > -0.05, lo + ends[:, 0] * (hi - lo), -1e9)
        high = np.where(ends[:, 1] < 1.05, lo + ends[:, 1] * (hi - lo), 1e9)
        clip = Clip((low[0], low[1], low[2]), (high[0], high[1], high[2])) if self._clip.value else None
        self._session.ask(clip=clip)

    def _camera(self) -> None:
        session, gui = self._session, self._session.client.gui
        with gui.add_folder("Camera", expand_by_default=False):
            self._up = gui.add_dropdown("Up axis", UPS, initial_value=UPS[0])
            self._name = gui.add_text("Name", "view 1")
            keep = gui.add_button("Keep this view", icon="bookmark")
            self._kept = gui.add_dropdown("Views", ("—",), initial_value="—")
            fly = gui.add_button("Go to the view", icon="plane")
        self._up.on_update(lambda _: session.safely(self._turn))
        keep.on_click(lambda _: session.safely(self._keep))
        fly.on_click(lambda _: session.safely(self._fly))

    def _turn(self) -> None:
        session, name = self._session, self._up.value
        up = session.contents.up
        if name != UPS[0]:
            axis = np.zeros(3)
            axis["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
            up = session.contents.given_from_world.rotation.T @ axis
        session.client.scene.set_up_direction(up)
        session.client.camera.up_direction = up

    def _keep(self) -> None:
        session = self._session
        name = self._name.value.strip() or f"view {len(session.hub.views) + 1}"
        session.hub.views[name] = session.eye()
        session.hub.refresh_all()
        self._name.value = f"view {len(session.hub.views) + 1}"

    def _names(self) -> None:
        names = tuple(self._session.hub.views) or ("—",)
        if tuple(self._kept.options) != names:
            self._kept.options = names

    def _fly(self) -> None:
        view: Eye | None = self._session.hub.views.get(self._kept.value)
        if view is None:
            self._session.say("No view yet", "Keep one first.")
        else:
            self._session.fly_to(view)
