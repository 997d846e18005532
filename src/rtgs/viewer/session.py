"""One browser: its camera, what it asks to see, and the thread that draws for it."""

from __future__ import annotations

import contextlib
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import cv2
import numpy as np
import viser
from numpy.typing import NDArray

from rtgs.base.errors import RtgsError
from rtgs.images.pictures import Picture, to_picture
from rtgs.maths.geometry import SE3, rotation_from_quat
from rtgs.records.scene import Scene
from rtgs.viewer.contents import Contents
from rtgs.viewer.engine import Clip, Engine, Eye, Seen
from rtgs.viewer.picture import (
    GAP_PX,
    SHOWS,
    Frame,
    Look,
    Shade,
    beside,
    on_screen,
    percentiles,
    picture_of,
    swept,
    thermal_picture,
)
from rtgs.viewer.scale_check import check_scale

if TYPE_CHECKING:
    from rtgs.viewer.start import Hub

Mode = Literal["RGB", "Temperature", "Blend", "Side by side", "Photo and render", "Scale check"]
MODES: tuple[Mode, ...] = get_args(Mode)
RangeKind: TypeAlias = Literal["of the run", "percentiles of the view", "by hand"]
RANGES: tuple[RangeKind, ...] = get_args(RangeKind)
Sensor: TypeAlias = Literal["RGB", "thermal"]

REST_S = 0.15  # without a move: the camera rests
MOVING_S = 0.07  # aim for a picture while the camera moves
LARGEST_PX = 1920  # of a picture's longer side
_DEPTH_PX = 400  # likewise of its depth, which only has to hide what lies behind


@dataclass(frozen=True)
class Wish:
    """What a person has chosen to see. Temperatures are in the thermal model's unit.

    Attributes:
        percentiles: of the view, for that kind of range. by_hand: ends of the range, likewise.
        isotherm: None: off.
        frame, sensor: the photograph of "Photo and render"; the frame of "Scale check" too. sweep: share that the photograph takes.
        tried: scale of "Scale check" and of the thermal cameras shown, as a multiple of the estimate.
    """

    mode: Mode = "RGB"
    palette: str = "inferno"
    range_kind: RangeKind = "of the run"
    percentiles: tuple[float, float] = (2.0, 98.0)
    by_hand: tuple[float, float] = (0.0, 50.0)
    isotherm: tuple[float, float] | None = None
    blend: float = 0.5
    unit: Shade = "°C"
    clip: Clip | None = None
    frame: str = ""
    sensor: Sensor = "thermal"
    sweep: float = 0.5
    tried: float = 1.0


@dataclass(frozen=True, eq=False)
class Shown:
    """A picture as it is on the screen.

    Attributes:
        picture: `[H, W, 3]`. look: how it was drawn.
        eyes: what each part of it is seen from, with where that part lies on the screen, in pixels of the picture.
        seen: what was rendered for it; None where it is no free view.
        note: a line for people.
    """

    picture: Picture
    look: Look
    eyes: tuple[tuple[Eye, Frame], ...] = ()
    seen: Seen | None = None
    note: str = ""

    def at(self, x: float, y: float) -> tuple[Eye, float, float] | None:
        """The eye and the pixel in its view at a place of the screen, both in [0, 1]; None where there is none."""
        height, width = self.picture.shape[:2]
        for eye, frame in self.eyes:
            column, row = frame.pixel(x * width, y * height)
            if 0 <= column < eye.camera.width and 0 <= row < eye.camera.height:
                return eye, column, row
        return None


@dataclass(eq=False)
class Pace:
    """How large pictures are while the camera moves, so that they come in time."""

    share: float = 0.6

    def learn(self, seconds: float) -> None:
        """From the time that one took."""
        self.share = float(np.clip(self.share * np.clip(np.sqrt(MOVING_S / max(seconds, 1e-3)), 0.7, 1.3), 0.15, 1.0))


class Painter:
    """Draws what a person has chosen. It knows no browser."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self._kept: tuple[Any, Seen] | None = None

    def draw(self, wish: Wish, eye: Eye, *, depth: bool = False) -> Shown:
        """The picture of a screen of the eye's size."""
        if wish.mode == "Scale check":
            return self._scale(wish, eye)
        if wish.mode == "Photo and render":
            return self._photo(wish, eye)
        return self._free(wish, eye, depth)

    def look_of(self, wish: Wish, temperature: NDArray[np.float32] | None) -> Look:
        """Palette, range and isotherm for a view."""
        thermal = self.engine.contents.thermal
        lo, hi = (0.0, 1.0) if thermal is None else (thermal.range.lo, thermal.range.hi)
        if wish.range_kind == "by hand":
            lo, hi = wish.by_hand
        elif wish.range_kind == "percentiles of the view" and temperature is not None:
            lo, hi = percentiles(temperature, *wish.percentiles) or (lo, hi)
        show = wish.mode if wish.mode in SHOWS else "Temperature"
        return Look(show, wish.palette, lo, max(hi, lo + 1e-3), wish.isotherm, wish.blend)

    def _free(self, wish: Wish, eye: Eye, depth: bool) -> Shown:
        both = wish.mode == "Side by side"
        width = eye.camera.width
        inner = _narrowed(eye, max((width - GAP_PX) // 2, 1)) if both else eye
        look = Look(wish.mode if wish.mode in SHOWS else "RGB")
        seen = self._seen(inner, look.wants_rgb, look.wants_temperature, depth and not both, wish.clip)
        look = self.look_of(wish, seen.temperature)
        if not both:
            return Shown(picture_of(seen, look), look, ((eye, Frame(0, 0, 1)),), seen)
        left, right = (picture_of(seen, replace(look, show=show)) for show in ("RGB", "Temperature"))
        frames = tuple((inner, Frame(left_px, 0, 1)) for left_px in (0, inner.camera.width + GAP_PX))
        return Shown(beside(left, right), look, frames, seen)

    def _seen(self, eye: Eye, rgb: bool, temperature: bool, depth: bool, clip: Clip | None) -> Seen:
        """What is seen from there; kept, for changes that concern the palette alone."""
        pose = eye.world_from_camera
        place = (eye.camera, pose.rotation.tobytes(), pose.translation.tobytes())
        key = (self.engine.contents, *place, rgb, temperature, depth, clip)
        if self._kept is None or self._kept[0] != key:
            self._kept = (key, self.engine.look(eye, rgb=rgb, temperature=temperature, depth=depth, clip=clip))
        return self._kept[1]

    def _photo(self, wish: Wish, eye: Eye) -> Shown:
        scene, scale = self.engine.contents.scene, self.engine.contents.scale
        size = eye.camera.width, eye.camera.height
        if scene is None or wish.frame not in scene.world_from_rgb or (scale is None and wish.sensor == "thermal"):
            return Shown(on_screen(np.zeros((3, 4, 3), np.uint8), *size), Look(), note="This photograph is not there yet.")
        assert scale is not None or wish.sensor == "RGB"
        photo = next(f for f in scene.frames if f.name == wish.frame)
        here = photo_eye(scene, wish.frame, wish.sensor, 1.0 if scale is None else scale.sfm_per_metre)
        thermal = wish.sensor == "thermal"
        if thermal:  # as its sensor shows the scene, with drift and pattern
            seen = Seen(here, temperature=self.engine.photographed(here, wish.frame))
        else:
            seen = self._seen(here, True, False, False, None)
        look = self.look_of(wish, photo.thermal if thermal else None)
        look = replace(look, show="Temperature" if thermal else "RGB")
        picture = thermal_picture(photo.thermal, look) if thermal else to_picture(photo.rgb)
        frame = Frame.of(here.camera.width, here.camera.height, *size)
        note = f"{wish.frame}, {wish.sensor}: photograph on the left, model on the right"
        at = (frame.left + wish.sweep * frame.factor * here.camera.width) / size[0]
        shown = swept(on_screen(picture, *size), on_screen(picture_of(seen, look), *size), at)
        return Shown(shown, look, ((here, frame),), note=note)

    def _scale(self, wish: Wish, eye: Eye) -> Shown:
        size = eye.camera.width, eye.camera.height
        contents = self.engine.contents
        found = None
        if contents.scale is not None and contents.scene is not None and wish.frame in contents.scene.world_from_rgb:
            found = check_scale(self.engine, wish.frame, wish.tried * contents.scale.sfm_per_metre)
        if found is None:
            return Shown(
                on_screen(np.zeros((3, 4, 3), np.uint8), *size), Look(), note="The scale can be checked once it is known."
            )
        return Shown(
            on_screen(found.picture, *size),
            Look(),
            note=f"{100 * found.met:.0f} % of the thermal edges meet the render",
        )


def photo_eye(scene: Scene, frame: str, sensor: Sensor, sfm_per_metre: float) -> Eye:
    """Where a photograph was taken from."""
    if sensor == "RGB":
        return Eye(scene.rig.rgb, scene.world_from_rgb[frame])
    return Eye(scene.rig.thermal, scene.world_from_thermal(frame, sfm_per_metre))


def _narrowed(eye: Eye, width: int) -> Eye:
    """All that is seen from left to right, in a narrower picture."""
    camera = eye.camera
    factor = width / camera.width
    return replace(
        eye,
        camera=replace(camera, width=width, cx=factor * camera.cx, fl_x=factor * camera.fl_x, fl_y=factor * camera.fl_y),
    )


@dataclass(eq=False)
class _State:
    """What the drawing thread and the browser's callbacks share."""

    version: int = 0
    drawn: tuple[int, bool] = (-1, False)
    moved_at: float = 0.0
    closed: bool = False
    changed: threading.Condition = field(default_factory=threading.Condition)


class Session:
    """One browser.

    Attributes:
        hub: what all browsers share. client: the connection.
        wish: what is shown. shown: the latest picture at full size.
        overlays: names of 3D things that need depth to be hidden by the model.
        sent: when pictures were sent (as `time.time`), the latest ones, and whether at full size.
    """

    def __init__(self, hub: Hub, client: viser.ClientHandle) -> None:
        self.hub, self.client = hub, client
        self.painter, self.wish, self.pace = Painter(hub.engine), Wish(), Pace()
        self.shown: Shown | None = None
        self.overlays: set[str] = set()
        self.sent: deque[tuple[float, bool]] = deque(maxlen=1000)
        self.after_drawing: list[Callable[[Shown], None]] = []
        self._state = _State()
        client.camera.on_update(self._camera_moved)
        self._thread = threading.Thread(target=self._loop, name=f"viewer {client.client_id}", daemon=True)

    def start(self) -> None:
        """Begin to draw."""
        self._thread.start()

    def close(self) -> None:
        """End the thread; the browser has gone."""
        with self._state.changed:
            self._state.closed = True
            self._state.changed.notify_all()

    @property
    def contents(self) -> Contents:
        return self.hub.engine.contents

    @property
    def closed(self) -> bool:
        """Whether the browser has gone."""
        return self._state.closed

    @property
    def settled(self) -> bool:
        """Whether the latest picture is that of the latest wish and of a camera at rest."""
        with self._state.changed:
            return self._state.drawn == (self._state.version, True)

    def ask(self, **changes: Any) -> None:
        """Show something else."""
        self.wish = replace(self.wish, **changes)
        self.redraw()

    def redraw(self, *, moved: bool = False) -> None:
        with self._state.changed:
            self._state.version += 1
            if moved:
                self._state.moved_at = time.monotonic()
            self._state.changed.notify_all()

    def safely(self, work: Callable[[], None]) -> None:
        """Do something for the browser. What goes wrong is said on the page."""
        try:
            work()
        except RtgsError as error:
            self.say("This cannot be done", str(error))
        except Exception as error:
            if not self._state.closed:
                traceback.print_exc()
                self.say("A defect of the viewer", f"{type(error).__name__}: {error}")

    def say(self, title: str, text: str) -> None:
        """A notice on the page."""
        if not self._state.closed:
            self.client.add_notification(title, text, auto_close_seconds=12.0)

    def eye(self, share: float = 1.0) -> Eye:
        """Where the browser's camera is, for a picture of this share of its window."""
        camera = self.client.camera
        width, height = max(camera.image_width, 1), max(camera.image_height, 1)
        share = min(share, LARGEST_PX / max(width, height))
        pose = SE3(rotation_from_quat(camera.wxyz), np.asarray(camera.position, np.float64))
        return Eye.of(max(round(width * share), 16), max(round(height * share), 16), camera.fov, pose)

    def fly_to(self, eye: Eye, distance: float | None = None) -> None:
        """Put the browser's camera there, with the eye's vertical angle of view."""
        pose, camera = eye.world_from_camera, self.client.camera
        if distance is None:
            found = self.hub.engine.distance(eye, eye.camera.width / 2, eye.camera.height / 2)
            distance = found if np.isfinite(found) else 1.0
        with self.client.atomic():
            camera.position = pose.translation
            camera.up_direction = -pose.rotation[:, 1]
            camera.look_at = pose.translation + distance * pose.rotation[:, 2]
            camera.fov = 2 * float(np.arctan(0.5 * eye.camera.height / eye.camera.fl_y))

    async def _camera_moved(self, _: viser.CameraHandle) -> None:
        self.redraw(moved=True)

    def _loop(self) -> None:
        state = self._state
        while True:
            with state.changed:
                while not state.closed and state.drawn == (state.version, True):
                    state.changed.wait()
                if state.closed:
                    return
                version, rest = state.version, state.moved_at + REST_S - time.monotonic()
                if rest > 0 and state.drawn[0] == version:  # drawn small already: wait whether the camera goes on
                    state.changed.wait(rest)
                    continue
            full = rest <= 0 or self.wish.mode not in SHOWS
            self.safely(lambda full=full: self._draw(full))  # type: ignore[misc]
            with state.changed:
                state.drawn = (version, full)

    def _draw(self, full: bool) -> None:
        started = time.monotonic()
        wish, free = self.wish, self.wish.mode in SHOWS
        eye = self.eye(1.0 if full else self.pace.share)
        shown = self.painter.draw(wish, eye, depth=bool(self.overlays) and free)
        depth = None if shown.seen is None or not self.overlays else _small_depth(shown.seen)
        self.client.scene.set_background_image(shown.picture, "jpeg", jpeg_quality=92 if full else 75, depth=depth)
        self.client.flush()
        self.sent.append((time.time(), full))
        if not full:
            self.pace.learn(time.monotonic() - started)
            return
        self.shown = shown
        for then in self.after_drawing:
            then(shown)


def _small_depth(seen: Seen) -> NDArray[np.float32] | None:
    if seen.depth is None:
        return None
    depth: NDArray[np.float32] = np.nan_to_num(seen.depth, nan=160.0)
    height, width = depth.shape
    factor = min(1.0, _DEPTH_PX / max(height, width))
    if factor < 1.0:
        size = max(1, round(width * factor)), max(1, round(height * factor))
        depth = np.asarray(cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST), np.float32)
    return np.ascontiguousarray(depth)


@contextlib.contextmanager
def long_action(session: Session, progress: Any, *buttons: Any) -> Iterator[Callable[[float], None]]:
    """Long work for a browser, which ends when the browser goes. Meanwhile its buttons cannot be used, and a bar shows the share done."""

    def tell(share: float) -> None:
        if session.closed:
            raise _GoneError
        progress.value = 100.0 * share

    tell(0.0)
    progress.visible = True
    for button in buttons:
        button.disabled = True
    try:
        yield tell
    finally:
        if not session.closed:
            progress.visible = False
            for button in buttons:
                button.disabled = False


class _GoneError(Exception):
    """The browser has gone, and with it the reason for some work."""
