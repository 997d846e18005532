"""The tab "Photos": where the photographs were taken from, a jump to each, and a swipe between it and the model."""

from __future__ import annotations

import math
import threading

import cv2
import numpy as np
import viser
from numpy.typing import NDArray

from rtgs.images.pictures import palette, to_picture
from rtgs.viewer.panel_view import Head
from rtgs.viewer.session import Sensor, Session, Shown, photo_eye

_THUMB_PX = 128
_SMALLEST, _LARGEST = 0.03, 0.12  # camera in the picture, of the world's size
_COLOURS: dict[Sensor, tuple[int, int, int]] = {"RGB": (90, 170, 255), "thermal": (255, 140, 60)}


class PhotosPanel:
    """The tab "Photos"."""

    def __init__(self, session: Session, head: Head) -> None:
        self._session, self._head, gui = session, head, session.client.gui
        self._nodes: dict[tuple[Sensor, str], viser.CameraFrustumHandle] = {}
        self._drawn_for: object = None
        self._palette = session.wish.palette
        self._drawing = threading.Lock()  # two boxes that are ticked at once
        names = self._frames()
        with gui.add_folder("A photograph"):
            self._frame = gui.add_dropdown("Frame", names, initial_value=names[0])
            self._sensor = gui.add_dropdown("Sensor", ("thermal", "RGB"), initial_value="thermal")
            self._sweep = gui.add_slider(
                "Swipe", 0.0, 1.0, 0.01, 0.5, hint="The photograph on the left of it, the model on the right."
            )
            show = gui.add_button("Compare with the model", icon="arrows-left-right")
            fly = gui.add_button("Jump to its camera", icon="camera")
        with gui.add_folder("All cameras"):
            self._rgb = gui.add_checkbox("RGB", False)
            self._thermal = gui.add_checkbox("Thermal", False)
            self._pictures = gui.add_checkbox("Photographs", True, hint="Each with its photograph.")
        session.ask(frame=names[0])
        session.after_drawing.append(self._follow)
        for control in (self._frame, self._sensor, self._sweep):
            control.on_update(lambda _: session.safely(self._take))
        show.on_click(lambda _: session.safely(lambda: self._head.show("Photo and render")))
        fly.on_click(lambda _: session.safely(lambda: self.jump(self._frame.value, self._sensor.value)))
        for box in (self._rgb, self._thermal, self._pictures):
            box.on_update(lambda _: session.safely(self.draw_cameras))

    def refresh(self) -> None:
        """After the run has changed."""
        names = self._frames()
        if tuple(self._frame.options) != names:
            self._frame.options = names
            self._session.ask(frame=self._frame.value)
        self._drawn_for = None
        self.draw_cameras()

    def choose(self, frame: str, sensor: Sensor) -> None:
        """A photograph as if a person had chosen it."""
        self._frame.value, self._sensor.value = frame, sensor
        self._take()

    def jump(self, frame: str, sensor: Sensor) -> None:
        """Put the browser's camera where a photograph was taken."""
        session = self._session
        scene, scale = session.contents.scene, session.contents.scale
        if scene is None or frame not in scene.world_from_rgb or (scale is None and sensor == "thermal"):
            session.say("Not yet", "The pose of this photograph is not known yet.")
            return
        if session.wish.mode in ("Photo and render", "Scale check"):
            self._head.show("Temperature" if sensor == "thermal" else "RGB")
        session.fly_to(photo_eye(scene, frame, sensor, 1.0 if scale is None else scale.sfm_per_metre))

    def draw_cameras(self) -> None:
        """The cameras in the picture: the thermal ones where the scale that is tried puts them."""
        with self._drawing:
            wanted = self._draw()
        session = self._session
        (session.overlays.add if wanted else session.overlays.discard)("cameras")
        session.redraw()

    def _draw(self) -> list[Sensor]:
        session, contents = self._session, self._session.contents
        scene, scale = contents.scene, contents.scale
        wanted: list[Sensor] = []
        if scene is not None:
            wanted += ["RGB"] if self._rgb.value else []
            wanted += ["thermal"] if self._thermal.value and scale is not None else []
        self._palette = session.wish.palette
        key = (contents, tuple(wanted), self._pictures.value, self._palette)
        if key != self._drawn_for:
            self._drawn_for = key
            for node in self._nodes.values():
                node.remove()
            self._nodes.clear()
            for sensor in wanted:
                self._add(sensor)
        if scene is not None and scale is not None:
            tried = session.wish.tried * scale.sfm_per_metre
            for (sensor, name), node in self._nodes.items():
                if sensor == "thermal":
                    node.position = scene.world_from_thermal(name, tried).translation
        return wanted

    def _follow(self, _: Shown) -> None:
        """The photographs in the palette of the picture."""
        if self._nodes and self._palette != self._session.wish.palette:
            self.draw_cameras()

    def _add(self, sensor: Sensor) -> None:
        session, contents = self._session, self._session.contents
        assert contents.scene is not None
        scene, factor = contents.scene, 1.0 if contents.scale is None else contents.scale.sfm_per_metre
        camera = scene.rig.rgb if sensor == "RGB" else scene.rig.thermal
        span = contents.thermal.range if contents.thermal is not None else None
        size = _size([pose.translation for pose in scene.world_from_rgb.values()])
        for frame in scene.frames:
            image = None
            if self._pictures.value:
                values = frame.rgb if sensor == "RGB" else frame.thermal
                small = cv2.resize(
                    values, (_THUMB_PX, max(1, _THUMB_PX * camera.height // camera.width)), interpolation=cv2.INTER_AREA
                )
                lo, hi = (span.lo, span.hi) if span is not None else (float(small.min()), float(small.max()) + 1e-6)
                image = to_picture(small) if sensor == "RGB" else palette(small, lo, hi, self._palette)
            pose = photo_eye(scene, frame.name, sensor, factor).world_from_camera
            node = session.client.scene.add_camera_frustum(
                f"/cameras/{sensor}/{len(self._nodes)}",
                fov=2 * math.atan(0.5 * camera.height / camera.fl_y),
                aspect=camera.width / camera.height,
                scale=size,
                thickness=2.0,
                thickness_units="screen",
                color=_COLOURS[sensor],
                image=image,
                wxyz=viser.transforms.SO3.from_matrix(pose.rotation).wxyz,
                position=pose.translation,
            )
            node.on_click(lambda _, name=frame.name: session.safely(lambda: self._clicked(name, sensor)))
            self._nodes[sensor, frame.name] = node

    def _clicked(self, frame: str, sensor: Sensor) -> None:
        self.choose(frame, sensor)
        self.jump(frame, sensor)

    def _take(self) -> None:
        self._session.ask(frame=self._frame.value, sensor=self._sensor.value, sweep=self._sweep.value)

    def _frames(self) -> tuple[str, ...]:
        scene = self._session.contents.scene
        return ("—",) if scene is None else tuple(scene.world_from_rgb)


def _size(centres: list[NDArray[np.float64]]) -> float:
    """Of the cameras in the picture, in the world: so that neighbours can be told apart."""
    from scipy.spatial import cKDTree  # slow to import, and a page opens without it

    if len(centres) < 2:
        return _LARGEST
    apart = cKDTree(centres).query(centres, k=2)[0][:, 1]
    return float(np.clip(0.5 * np.median(apart), _SMALLEST, _LARGEST))
