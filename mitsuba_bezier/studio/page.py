"""The page of the studio, on viser: points to drag, sliders, buttons; one worker renders."""

from __future__ import annotations

import contextlib
import io
import socket
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BezierError, GeometryError, RuntimeSetupError
from ..geometry.camera import Camera
from ..geometry.curves import BezierCurve
from ..io import save
from .canvas import Canvas
from .figure import Drawn
from .front import Front, front_of
from .picture import FINEST, MODES, Painter
from .presets import NETS, Preset, drawings
from .state import State, slider_of, weight_of
from .views import camera_of, first_view

__all__ = ["Studio", "checked_port"]

#: Pixels across of pictures: of the first after a change, and of those when nothing moves.
FIRST, STILL = 512, 1024
#: Pixels across of pictures that are saved.
SAVED = 1600

#: Field of view of browsers, in radians: narrower than viser's own, which bends a net.
FOV = float(np.radians(40))

#: Pixels across of the controls in a wide window, which a drawing leaves free.
PANEL = 350

#: Seconds without a change after which the picture is refined.
REST = 0.3

#: Highest degree that can be reached: nets above are too dense to be dragged.
HIGHEST = 12

#: A net that is none of the lecture's figures: from a file, or from Python.
OWN = "your own net"

#: What the page says where there is nothing else to say.
HELP = "Drag a point, or the ground to turn. Shift and drag moves the view."


def checked_port(host: str, port: int) -> int:
    """Return a port that is free.

    Raises
    ------
    GeometryError
        If it is taken, or the host is none of this machine.
    """
    if not 0 < port < 65536:
        raise GeometryError.expected("--port", "a number from 1 to 65535", port)
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise GeometryError.expected(
                "--host, --port", "an address that is free", f"{host}:{port} ({error.strerror})"
            ) from None
    return port


def _served(host: str, port: int) -> Any:
    """Return viser's server at an address, and no other."""
    try:
        import viser
    except ImportError as error:
        raise RuntimeSetupError.expected(
            "studio", "viser, which serves its page",
            f"none ({error}): pip install 'mitsuba-bezier[studio]'",
        ) from None  # fmt: skip
    with contextlib.redirect_stdout(io.StringIO()):  # it prints a box
        server = viser.ViserServer(host, checked_port(host, port), "Bézier", verbose=False)
        if server.get_port() != port:  # taken since it was checked: viser has gone on to the next
            server.stop()
            raise GeometryError.expected(
                "--host, --port", "an address that is free", f"{host}:{port}"
            )
    # sharing would put the page on the internet
    server.gui.configure_theme(show_share_button=False, show_logo=False, brand_color=(33, 77, 133))
    return server


class Studio:
    """A page on localhost with one net, shared by all browsers that look at it.

    Parameters
    ----------
    net : (K, 4) array_like, or str
        What is shown first: a net of a triangle, or the name of a figure.
    host, port
        Where the page is.
    folder : path
        Where files are saved.

    Raises
    ------
    RuntimeSetupError
        Without the extra ``studio``.
    GeometryError
        If the address is taken, or there is no such figure.
    """

    def __init__(self, net: Any, host: str, port: int, folder: Path) -> None:
        self.folder = folder
        self.figure = net if isinstance(net, str) else OWN
        self._own = None if isinstance(net, str) else np.array(net, dtype=np.float64)
        self.drawn: Drawn | None = None
        self.look = Preset(lambda: np.zeros(0), HELP)
        if self.figure in NETS:
            self.look = NETS[self.figure]
            net = self.look()
        elif self.figure in drawings():
            self.drawn, net = Drawn(self.figure), next(iter(NETS.values()))()
        elif isinstance(net, str):
            known = ", ".join((*NETS, *drawings()))
            raise GeometryError.expected("name", "one of " + known, repr(net))
        self.state = State(net, self.look.curve)
        self.server = _served(host, port)
        self.painter = Painter(None if self.state.curve else self.state.patches)
        self.canvas = Canvas(self.server.scene)
        self.selected = min(self.look.row, len(self.state.net) - 1)
        self._lock, self._brush = threading.RLock(), threading.Lock()
        self._changed_at = time.monotonic()
        self._wake, self._stop = threading.Event(), threading.Event()
        self._shown: dict[int, tuple[Any, ...]] = {}
        self._views: dict[int, Any] = {}
        self._message = ""
        #: does what browsers ask for, one thing after the other
        self._asked = ThreadPoolExecutor(1)
        self.front = Front()
        #: Seconds that first pictures took, the last hundred; for whoever measures.
        self.latencies: list[float] = []
        self._controls()
        self._rebuild()
        self.server.on_client_connect(self._connected)
        self.server.on_client_disconnect(self._gone)
        self._worker = threading.Thread(target=self._work, daemon=True)
        self._worker.start()

    # ------------------------------------------------------------------ controls

    def _controls(self) -> None:
        gui = self.server.gui
        names = (*([OWN] if self._own is not None else []), *NETS, *drawings())
        self.preset = gui.add_dropdown("figure", names, initial_value=self.figure)
        self.said = gui.add_markdown("")
        self.mode = gui.add_dropdown("picture", MODES, hint="light is path traced when it rests")
        self.point: Any = gui.add_slider("point", 0, max(len(self.state.net) - 1, 1), 1, 0)
        self.weight: Any = gui.add_slider(
            "weight", -2.0, 4.0, 0.01, 1.0, marks=((-2, "-2"), (0, "0"), (1, "1"), (4, "∞"))
        )
        self.places = [gui.add_slider(name, 0.0, 1.0, 0.01, start)
                       for name, start in (("t", 0.4), ("u", 0.3), ("v", 0.3))]  # fmt: skip
        self._arguments: list[Any] = []
        self._order = gui.add_folder("numbers", visible=False)
        self.told = gui.add_markdown("")
        self.names = gui.add_checkbox("names", True, hint="indices of the control points")
        self.arrows = gui.add_checkbox("arrows", False, hint="to move along one axis")
        self.degree = gui.add_button_group("degree", ("lower", "raise"))
        self.undo = gui.add_button("undo")
        self.files = gui.add_button_group("save", (".vtu", ".png", ".svg"))
        self.preset.on_update(self._ordered(lambda name, _client: self._load(str(name))))
        self.mode.on_update(self._ordered(lambda _mode, _client: self._touch()))
        self.point.on_update(self._ordered(lambda row, _client: self._select(row)))
        self.weight.on_update(self._ordered(lambda value, _client: self._weigh(value)))
        for handle in (*self.places, self.names, self.arrows):
            handle.on_update(self._ordered(lambda _value, _client: self._redraw()))
        self.degree.on_click(self._ordered(
            lambda way, _client: self._raise() if way == "raise" else self._lower()))  # fmt: skip
        self.undo.on_click(self._ordered(lambda _value, _client: self._undo()))
        self.files.on_click(self._ordered(lambda suffix, client: self.save(str(suffix), client)))

    def _ordered(self, action: Callable[[Any, Any], Any]) -> Callable[[Any], Any]:
        """Return what a control calls: ``action(value, client)``, in the order of the events.

        Viser's threads may overtake each other, and a control may have another value by the time
        that something slow before it, a file that is saved, has ended.
        """

        async def handle(event: Any) -> None:
            value = getattr(event.target, "value", None)
            if event.client:  # not what this program has set by itself
                self._ask(lambda: action(value, event.client))

        return handle

    def _ask(self, action: Callable[[], Any]) -> None:
        """Do something after all that was asked for before."""
        with contextlib.suppress(RuntimeError):  # the page is closed
            self._asked.submit(self._guarded, action).add_done_callback(_print_error)

    def _guarded(self, action: Any) -> None:
        """Do what a browser asks for; what cannot be done is told on the page, nothing is lost."""
        with self._lock:
            self._message = ""
            try:
                action()
            except BezierError as error:
                self._message = f"*{error}*"
            self._tell()
            self._touch()

    def _touch(self) -> None:
        self._changed_at = time.monotonic()
        self._wake.set()

    def _load(self, name: str) -> None:
        if name in drawings():
            self.drawn, self.figure = Drawn(name), name
        else:
            look = Preset(lambda: np.zeros(0), HELP) if name == OWN else NETS[name]
            net = self._own if name == OWN else look()
            self.state.load(net, look.curve)
            self.drawn, self.figure, self.look = None, name, look
            self.selected = look.row
        self._rebuild()
        for client in list(self._views.values()):
            self._frame(client)

    def _raise(self) -> None:
        if self.state.degree >= HIGHEST:
            raise GeometryError.expected("degree", f"at most {HIGHEST}", self.state.degree + 1)
        self.state.elevate()
        self._rebuild()

    def _lower(self) -> None:
        off = self.state.lower()
        if off > 1e-9:  # of the net's size; rounding of an elevation and back is 1e-15
            self._message = "*No net of this degree has the same shape: this is a near one.*"
        self._rebuild()

    def _undo(self) -> None:
        if not self.state.undo():
            self._message = "*nothing to undo*"
        self._rebuild()

    def _select(self, row: float) -> None:
        self.selected = int(min(row, len(self.state.net) - 1))
        self._redraw()

    def _weigh(self, value: float) -> None:
        self.state.weigh(self.selected, weight_of(value))
        self._redraw()

    # ------------------------------------------------------------------ what stands in front

    def _rebuild(self) -> None:
        """Show another net: its points, and the controls that it has."""
        drawn, last = self.drawn is not None, len(self.state.net) - 1
        self.selected = min(self.selected, last)
        self.point.max = max(last, 1)
        scheme = not drawn and "scheme" in self.look.shows
        for handle, shown in zip(self.places, (self.state.curve, *[not self.state.curve] * 2)):
            handle.visible = scheme and shown
        for handle in (self.mode, self.point, self.weight, self.names, self.arrows, self.degree,
                       self.undo):  # fmt: skip
            handle.visible = not drawn
        self.mode.visible = not drawn and not self.state.curve
        for handle in self._arguments:
            handle.remove()
        self._arguments = []
        self._order.visible = drawn and bool(self.drawn and self.drawn.arguments)
        if self.drawn is not None:
            with self._order:
                for a in self.drawn.arguments:
                    slider = self.server.gui.add_slider(a.name, a.low, a.high, a.step, a.start)
                    slider.on_update(self._argument(self.drawn, a.name))
                    self._arguments.append(slider)
        self.canvas.points(
            [] if drawn else list(self.state.places), self._chooser, self._dragger, self._size()
        )
        self._redraw()
        self._tell()

    def _argument(self, drawn: Drawn, name: str) -> Any:
        def move(value: float, _client: Any) -> None:
            if self.drawn is drawn:  # another figure may have been picked since
                drawn.move(name, value)

        return self._ordered(move)

    def _size(self) -> float:
        return float(np.ptp(self.state.places, axis=0).max() or 1.0)

    def _redraw(self) -> None:
        """Draw what stands before the picture."""
        if self.drawn is not None:
            self.canvas.clear()
            return
        t, u, v = (float(handle.value) for handle in self.places)
        if u + v > 0.98:
            u, v = u / (u + v) * 0.98, v / (u + v) * 0.98
        t = min(max(t, 1e-3), 1 - 1e-3)
        self.front = front_of(self.state, self.look.shows, t, (u, v))
        self.canvas.show(self.front, self._size())
        labels = [f"b{self.state.name(k)}" for k in range(len(self.state.net))]
        notes = [(text, x) for text, x in zip(labels, self.state.places)] + self.front.notes
        self.canvas.place(list(self.state.places), self.selected)
        self.canvas.write(notes if self.names.value else [])
        self.canvas.gizmo(
            self.state.places[self.selected] if self.arrows.value else None,
            0.3 * self._size(),
            self._pulled,
        )
        if self.point.value != self.selected:
            self.point.value = self.selected
        slider = slider_of(float(self.state.net[self.selected, 3]))
        if self.weight.value != slider and weight_of(self.weight.value) != self.state.net[
            self.selected, 3
        ]:  # fmt: skip
            self.weight.value = slider

    def _chooser(self, row: int) -> Any:
        async def choose(_event: Any) -> None:
            self._ask(lambda: self._select(row))

        return choose

    def _dragger(self, row: int) -> Any:
        """Return what a drag of a point calls; one after the other, as its phases come."""
        offset = np.zeros(3)

        async def drag(event: Any) -> None:
            def act() -> None:
                nonlocal offset
                if row >= len(self.state.net):
                    return  # a smaller net was loaded since
                if event.phase == "start":
                    self.selected = row
                    offset = self.state.places[row] - event.start_position
                    self.state.move(row, self.state.places[row])  # a step to go back to
                place = np.asarray(event.end_position, dtype=np.float64) + offset
                if self.look.flat and self.drawn is None:
                    place = _on_wall(place, event.client.camera.position)
                self.drag(row, place)

            self._ask(act)

        return drag

    async def _pulled(self, event: Any) -> None:
        place = np.array(event.target.position, dtype=np.float64)

        def act() -> None:
            if event.phase == "start":
                self.state.move(self.selected, self.state.places[self.selected])
            if self.look.flat:
                place[1] = 0.0
            self.drag(self.selected, place)

        self._ask(act)

    def drag(self, row: int, place: Any) -> None:
        """Move a control point as a drag does: the picture follows, the history has one step."""
        self.state.move(row, place, remember=False)
        self._redraw()

    def _tell(self) -> None:
        if self.drawn is not None:
            self.said.content = self.drawn.says
            self.told.content = self._message
            return
        self.said.content = self.look.says
        w = self.state.net[self.selected, 3]
        shown = "∞" if w >= 1e6 else f"{w:.3g}"
        kind = "control vector" if self.state.is_vector(self.selected) else f"weight {shown}"
        lines = [f"**degree {self.state.degree}, b{self.state.name(self.selected)}: {kind}**"]
        lines += [x for x in (self.front.says, self._message) if x]
        self.told.content = "\n\n".join(lines)

    # ------------------------------------------------------------------ pictures

    def _frame(self, client: Any) -> None:
        """Look at the net from where it is seen well."""
        with contextlib.suppress(AssertionError):  # a browser that has told no camera yet
            client.camera.fov = FOV
            around = np.concatenate(
                [self.state.places, *(x[None] for _text, x in self.front.notes)]
            )
            eye, at = first_view(around, self.look.view, self.look.flat, client.camera)
            client.camera.position, client.camera.look_at = tuple(eye), tuple(at)

    def _connected(self, client: Any) -> None:
        self._frame(client)
        self._views[client.client_id] = client
        client.camera.on_update(lambda _c: self._touch())
        self._touch()

    def _gone(self, client: Any) -> None:
        self._views.pop(client.client_id, None)
        self._shown.pop(client.client_id, None)

    def _work(self) -> None:
        """Render for one browser after the other, at once, then finer and finer; alone."""
        while not self._stop.is_set():
            more = False
            for client in list(self._views.values()):
                try:
                    more |= self._paint(client)
                except BezierError as error:
                    with self._lock:
                        self._message = f"*{error}*"
                        self._tell()
                except Exception:
                    # a browser that has gone away meanwhile, or has told no camera yet; whatever
                    # it is, the pictures of the others go on
                    continue
            if not more:
                self._wake.wait(timeout=REST)
            self._wake.clear()

    def _paint(self, client: Any) -> bool:
        """Send a browser the next picture, and return whether there is more to be done."""
        view = client.camera
        with self._lock:
            shape, version = self.state.shape, self.state.version
            drawn, mode = self.drawn, str(self.mode.value)
        what = (version, mode) if drawn is None else (drawn.key, "drawn")
        key = (*what, tuple(view.wxyz), tuple(view.position), view.fov, view.aspect)
        seen, passes = self._shown.get(client.client_id, ((), 0))
        if seen != key:
            begin = time.perf_counter()
            image = self._first(view, shape, drawn, mode)
            self._send(client, image, (key, 0), 80)
            self.latencies = [*self.latencies[-99:], time.perf_counter() - begin]
            return True
        finest = 1 if drawn is not None or isinstance(shape, BezierCurve) else FINEST[mode]
        if passes >= finest:
            return False
        if time.monotonic() - self._changed_at < REST:
            return len(self._views) > 1  # others may still have to be served
        if drawn is not None:
            self._send(
                client, drawn.picture(STILL, view.aspect, PANEL / view.image_width), (key, 1), 92
            )
            return False
        with self._brush:
            self.painter.show(None if isinstance(shape, BezierCurve) else shape)
            done = self.painter.refine(camera_of(view, STILL), mode)
            # 1, 4, 16, 64: what is better by half is sent
            finer = self.painter.refined() if done in (1, 4, 16, finest) else None
        if finer is not None:
            self._send(client, finer, (key, done), 90)
        else:
            self._shown[client.client_id] = key, max(done, passes)
        return done < finest

    def _first(self, view: Any, shape: Any, drawn: Drawn | None, mode: str) -> np.ndarray:
        if drawn is not None:
            return drawn.picture(FIRST, view.aspect, PANEL / view.image_width)
        with self._brush:
            self.painter.show(None if isinstance(shape, BezierCurve) else shape)
            return self.painter.paint(camera_of(view, FIRST), mode)

    def _send(self, client: Any, image: np.ndarray, shown: tuple[Any, ...], quality: int) -> None:
        if client.client_id not in self._views:
            return  # it has gone away meanwhile
        client.scene.set_background_image(image, "jpeg", jpeg_quality=quality)
        self._shown[client.client_id] = shown

    def refined(self, passes: int = 1) -> bool:
        """Return whether all browsers see the net as it is now, with so many samples a pixel."""
        with self._lock:
            what = self.state.version if self.drawn is None else self.drawn.key
            shown = [self._shown.get(c) for c in list(self._views)]
        return all(s is not None and s[0][0] == what and s[1] >= passes for s in shown)

    # ------------------------------------------------------------------ files

    def save(self, suffix: str, client: Any = None) -> Path:
        """Save the net (.vtu), the picture (.png) or the figure (.svg) of a browser's view.

        Raises
        ------
        BezierError
            If it cannot be written, or there is no browser to see it.
        """
        path = self.folder / f"{'studio' if self.drawn is None else self.drawn.name}{suffix}"
        if suffix == ".vtu":
            if self.drawn is not None or self.state.curve:
                raise GeometryError.expected("save .vtu", "a net of a surface", self.figure)
            save(self.state.patches, path)
        elif self.drawn is not None:
            with self._brush:
                self.drawn.save(path)
        else:
            client = client or next(iter(self._views.values()), None)
            if client is None:
                raise GeometryError.expected("view", "a browser that looks at the page", "none")
            self._save_view(path, camera_of(client.camera, SAVED))
        self._message = f"saved {path.name}"
        return path

    def _save_view(self, path: Path, camera: Camera) -> None:
        from .figure import view_drawing

        image = None
        with self._brush:
            if path.suffix == ".png" and not self.state.curve:
                self.painter.show(self.state.patches)
                image = self.painter.paint(camera, str(self.mode.value), 32)
            view_drawing(self.state, self.front, camera, image).save(path)

    def stop(self) -> None:
        """Close the page."""
        self._stop.set()
        self._wake.set()
        self._worker.join(timeout=10)
        self._asked.shutdown(cancel_futures=True)
        with contextlib.redirect_stdout(io.StringIO()):  # it prints that it has stopped
            self.server.stop()


def _print_error(done: Future[Any]) -> None:
    """Print what is no error of the user's; nobody else waits for it."""
    if not done.cancelled() and (error := done.exception()) is not None:
        traceback.print_exception(error)


def _on_wall(place: np.ndarray, eye: Any) -> np.ndarray:
    """Return the point of the plane y = 0 that is seen where a place is."""
    e = np.asarray(eye, dtype=np.float64)
    way = place - e
    if way[1] * e[1] >= 0:  # the plane is seen from its edge, or lies behind
        return place * [1.0, 0.0, 1.0]
    return e + way * (-e[1] / way[1])
