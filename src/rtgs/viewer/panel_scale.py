"""The tab "Scale": what the scale is, and what the edges of both modalities say at another one."""

from __future__ import annotations

import html
import math
from typing import Any

import numpy as np

from rtgs.scale import ScaleEstimate
from rtgs.viewer.panel_photos import PhotosPanel
from rtgs.viewer.panel_view import Head
from rtgs.viewer.pieces import block
from rtgs.viewer.scale_check import LEAST, LEGEND, MOST, curve_picture
from rtgs.viewer.session import Session


class ScalePanel:
    """The tab "Scale"."""

    def __init__(self, session: Session, head: Head, photos: PhotosPanel) -> None:
        self._session, self._head, self._photos = session, head, photos
        gui = session.client.gui
        self._facts = gui.add_html("")
        self._folder = gui.add_folder("Try another scale")
        with self._folder:
            self._slider = self._new_slider(None)
            self._tried = gui.add_html("")
            self._curve = gui.add_image(np.zeros((2, 2, 3), np.uint8), format="png", visible=False)
            show = gui.add_button("Show the edges", icon="vector")
            back = gui.add_button("Back to the estimate", icon="arrow-back-up")
            self._key = gui.add_html(_legend())
        show.on_click(lambda _: session.safely(lambda: self._head.show("Scale check")))
        back.on_click(lambda _: session.safely(self._reset))
        self.refresh()

    def refresh(self) -> None:
        """After the run has changed."""
        scale = self._session.contents.scale
        self._facts.content = _facts(scale)
        self._curve.visible = scale is not None
        if _marks(scale) != self._marks:
            with self._folder:
                self._slider = self._new_slider(self._slider)
        self._say()

    def _new_slider(self, old: Any) -> Any:
        """The slider, in the place of an old one: its marks cannot be changed."""
        session, self._marks = self._session, _marks(self._session.contents.scale)
        value, order = (1.0, None) if old is None else (old.value, old.order)
        if old is not None:
            old.remove()
        slider = session.client.gui.add_slider("× the estimate", LEAST, MOST, 0.01, value, marks=self._marks, order=order)
        slider.on_update(lambda _: session.safely(self._take))
        return slider

    def _take(self) -> None:
        self._session.ask(tried=float(self._slider.value))
        self._say()
        self._photos.draw_cameras()

    def _reset(self) -> None:
        self._slider.value = 1.0
        self._take()

    def _say(self) -> None:
        scale, tried = self._session.contents.scale, self._session.wish.tried
        if scale is None:
            self._tried.content = ""
            return
        value, where = tried * scale.sfm_per_metre, ""
        if scale.ci95 is not None:
            where = ", inside the interval" if scale.ci95[0] <= value <= scale.ci95[1] else ", outside of the interval"
        self._tried.content = block(f"<b>{value:.5g}</b> SfM units per {_per(scale)}{where}", name="rtgs-tried")
        self._curve.image = curve_picture(scale, value)


def _marks(scale: ScaleEstimate | None) -> tuple[float | tuple[float, str], ...]:
    """The estimate and the ends of its interval on the slider."""
    ends = () if scale is None or scale.ci95 is None else tuple(round(end / scale.sfm_per_metre, 3) for end in scale.ci95)
    return ((LEAST, "½"), *ends, (1.0, "estimate"), (MOST, "2"))


def _facts(scale: ScaleEstimate | None) -> str:
    if scale is None:
        text = "The scale is not known yet: lengths are in SfM units."
    else:
        text = f"<b>{scale.sfm_per_metre:.5g}</b> SfM units per {_per(scale)}, status <b>{scale.status}</b>"
        if scale.ci95 is not None:
            share = 100 * 0.5 * math.log(scale.ci95[1] / scale.ci95[0])
            text += f"<br>95 % interval {scale.ci95[0]:.5g} … {scale.ci95[1]:.5g} (± {share:.2g} %)"
        if scale.baseline_m is not None:
            text += f"<br>It rests on a baseline of {1000 * scale.baseline_m:.1f} mm between both cameras."
        if scale.reason:
            text += f"<br>{html.escape(scale.reason)}"
    return block(text)


def _per(scale: ScaleEstimate) -> str:
    return "metre" if scale.calibration is None or scale.baseline_m is not None else "baseline"


def _legend() -> str:
    items = " ".join(
        f'<span style="margin-right:12px;white-space:nowrap"><span style="display:inline-block;width:12px;height:4px;vertical-align:middle;'
        f'margin-right:4px;background:rgb{colour};outline:1px solid #8888"></span>{text}</span>'
        for text, colour in LEGEND
    )
    return block(items, size_px=12)
