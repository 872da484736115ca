"""The page of the studio, on viser: handles, sliders, buttons; one worker does all rendering."""

from __future__ import annotations

import socket
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BezierError, GeometryError, RuntimeSetupError
from ..geometry import bernstein
from ..geometry.camera import Camera
from ..geometry.triangles import BezierTriangles
from ..io import save
from .picture import MODES, Painter
from .state import PRESETS, State, slider_of, weight_of

__all__ = ["Studio", "checked_port"]

#: Pixels across of pictures: of the first after a change, and of those when nothing moves.
FIRST, STILL = 512, 1024

#: Seconds without a change after which the picture is refined, and paths a pixel of a refined one.
REST, PATHS = 0.35, 32


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


def camera_of(view: Any, width: int) -> Camera:
    """Return our camera of a browser's: a rotation that looks along +z with +y down."""
    a, x, y, z = (float(v) for v in view.wxyz)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - a * z), 2 * (x * z + a * y)],
            [2 * (x * y + a * z), 1 - 2 * (x * x + z * z), 2 * (y * z - a * x)],
            [2 * (x * z - a * y), 2 * (y * z + a * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    to_world = np.eye(4)
    to_world[:3, :3] = rotation * [-1.0, -1.0, 1.0]  # Mitsuba's x is to the left, its y up
    to_world[:3, 3] = view.position
    size = (width, max(round(width / float(view.aspect)), 16))
    return Camera(to_world, float(np.degrees(view.fov)), "y", size)


class Studio:
    """A page on localhost with one net, shared by all browsers that look at it.

    Parameters
    ----------
    net : (K, 4) array_like
        What is shown first.
    host, port
        Where the page is.
    folder : path
        Where files are saved.

    Raises
    ------
    RuntimeSetupError
        Without the extra ``studio``.
    GeometryError
        If the address is taken.
    """

    def __init__(self, net: Any, host: str, port: int, folder: Path) -> None:
        try:
            import viser
        except ImportError as error:
            raise RuntimeSetupError.expected(
                "studio", "viser, which serves its page", f"none ({error}): "
                "pip install 'mitsuba-bezier[studio]'",
            ) from None  # fmt: skip
        self.state, self.folder = State(net), folder
        self.painter = Painter(self.state.patches)
        self.server = viser.ViserServer(host, checked_port(host, port), "Bézier", verbose=False)
        self.server.scene.set_up_direction("+z")
        self.selected = 0
        self._lock, self._brush = threading.RLock(), threading.Lock()
        self._changed_at = time.monotonic()
        self._wake, self._stop = threading.Event(), threading.Event()
        self._shown: dict[int, tuple[Any, ...]] = {}
        self._views: dict[int, Any] = {}
        self._legs: Any = None
        self._points: list[Any] = []
        self._gizmo: Any = None
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
        self.preset = gui.add_dropdown("net", tuple(PRESETS))
        self.mode = gui.add_dropdown("picture", MODES, initial_value="light")
        self.point: Any = gui.add_slider("point", 0, len(self.state.net) - 1, 1, 0)
        self.weight: Any = gui.add_slider(
            "weight", -2.0, 4.0, 0.01, 1.0, marks=((-2, "-2"), (0, "0"), (1, "1"), (4, "∞"))
        )
        self.told = gui.add_markdown("")
        up, back = gui.add_button("raise the degree"), gui.add_button("undo")
        files = [gui.add_button(f"save {name}") for name in (".vtu", ".png", ".svg")]
        self.preset.on_update(lambda _e: self._guarded(self._load))
        self.mode.on_update(lambda _e: self._touch())
        self.point.on_update(lambda _e: self._guarded(self._select))
        self.weight.on_update(lambda e: self._guarded(self._weigh) if e.client else None)
        up.on_click(lambda _e: self._guarded(self._raise))
        back.on_click(lambda _e: self._guarded(self._undo))
        for button, suffix in zip(files, (".vtu", ".png", ".svg")):
            button.on_click(self._saver(suffix))

    def _saver(self, suffix: str) -> Any:
        return lambda event: self._guarded(lambda: self.save(suffix, event.client))

    def _chooser(self, row: int) -> Any:
        return lambda _event: self._guarded(lambda: self._choose(row))

    def _guarded(self, action: Any) -> None:
        """Do what a browser asks for; what cannot be done is told on the page, nothing is lost."""
        with self._lock:
            try:
                action()
            except BezierError as error:
                self.told.content = f"*{error}*"
            else:
                self._touch()

    def _touch(self) -> None:
        self._changed_at = time.monotonic()
        self._wake.set()

    def _load(self) -> None:
        self.state.load(PRESETS[self.preset.value]())
        self.selected = 0
        self._rebuild()

    def _raise(self) -> None:
        if self.state.degree >= 12:
            raise GeometryError.expected("degree", "at most 12", self.state.degree + 1)
        self.state.elevate()
        self._rebuild()

    def _undo(self) -> None:
        if not self.state.undo():
            self.told.content = "*nothing to undo*"
        self._rebuild()

    def _select(self) -> None:
        self.selected = int(min(self.point.value, len(self.state.net) - 1))
        self._place_gizmo()

    def _weigh(self) -> None:
        self.state.weigh(self.selected, weight_of(self.weight.value))
        self._tell()

    # ------------------------------------------------------------------ the net in front

    def _rebuild(self) -> None:
        scene = self.server.scene
        for handle in self._points:
            handle.remove()
        size = 0.022 * float(np.ptp(self.state.places, axis=0).max() or 1.0)
        self._points = []
        for row, place in enumerate(self.state.places):
            ball = scene.add_icosphere(f"/net/{row}", size, (205, 70, 30), position=place)
            ball.on_click(self._chooser(row))
            self._points.append(ball)
        self.selected = min(self.selected, len(self.state.net) - 1)
        self.point.max = len(self.state.net) - 1
        self._draw_legs()
        self._place_gizmo()

    def _choose(self, row: int) -> None:
        self.point.value = row  # which selects it
        self.selected = row
        self._place_gizmo()

    def _draw_legs(self) -> None:
        n, x = self.state.degree, self.state.places
        pairs = set()
        for i, j, _k in bernstein.multi_indices(n - 1).tolist():
            rows = (bernstein.row(n, i + 1, j), bernstein.row(n, i, j + 1), bernstein.row(n, i, j))
            pairs |= {(min(a, b), max(a, b)) for a, b in zip(rows, rows[1:] + rows[:1])}
        lines = np.array([[x[a], x[b]] for a, b in sorted(pairs)], dtype=np.float32)
        self._legs = self.server.scene.add_line_segments(
            "/net/legs", lines, (60, 60, 66), thickness=2.0, thickness_units="screen"
        )

    def _place_gizmo(self) -> None:
        scale = 0.25 * float(np.ptp(self.state.places, axis=0).max() or 1.0)
        self._gizmo = self.server.scene.add_transform_controls(
            "/gizmo", scale, disable_rotations=True, depth_test=False,
            position=self.state.places[self.selected],
        )  # fmt: skip
        self._gizmo.on_update(lambda event: self._guarded(lambda: self._drag(event)))
        self.weight.value = slider_of(float(self.state.net[self.selected, 3]))
        self._tell()

    def _drag(self, event: Any) -> None:
        if event.phase == "start":  # a step to go back to
            self.state.move(self.selected, self.state.places[self.selected])
        self.drag(self.selected, np.array(self._gizmo.position, dtype=np.float64))

    def drag(self, row: int, place: Any) -> None:
        """Move a control point as a drag does: the picture follows, the history has one step."""
        self.state.move(row, place, remember=False)
        self._points[row].position = self.state.places[row]
        self._draw_legs()

    def _tell(self) -> None:
        i, j, k = bernstein.multi_indices(self.state.degree)[self.selected].tolist()
        w = self.state.net[self.selected, 3]
        shown = "∞" if w >= 1e6 else f"{w:.3g}"
        self.told.content = f"degree {self.state.degree}, point {i}{j}{k}, weight {shown}"

    # ------------------------------------------------------------------ pictures

    def _connected(self, client: Any) -> None:
        middle = self.state.places.mean(axis=0)
        size = float(np.ptp(self.state.places, axis=0).max() or 1.0)
        client.camera.position = tuple(middle + size * np.array([0.75, -1.35, 0.75]))
        client.camera.look_at = tuple(middle)
        self._views[client.client_id] = client
        client.camera.on_update(lambda _c: self._touch())
        self._touch()

    def _gone(self, client: Any) -> None:
        self._views.pop(client.client_id, None)
        self._shown.pop(client.client_id, None)

    def _work(self) -> None:
        """Render for one browser after the other, quickly, then finely; no other thread does."""
        while not self._stop.is_set():
            self._wake.wait(timeout=REST)
            self._wake.clear()
            still = time.monotonic() - self._changed_at > REST
            for client in list(self._views.values()):
                try:
                    self._paint(client, still)
                except BezierError as error:
                    self.told.content = f"*{error}*"
                except (RuntimeError, AssertionError, OSError):
                    continue  # a browser that has gone away, or that has told no camera yet

    def _paint(self, client: Any, still: bool) -> None:
        view = client.camera
        with self._lock:
            patches, version = self.state.patches, self.state.version
        mode = self.mode.value
        key = (version, tuple(view.wxyz), tuple(view.position), view.fov, view.aspect, mode, still)
        shown = self._shown.get(client.client_id)
        if shown == key or (shown is not None and shown[:-1] == key[:-1] and not still):
            return
        begin = time.perf_counter()
        quick = "normals" if mode == "light" else mode
        camera = camera_of(view, STILL if still else FIRST)
        with self._brush:
            self.painter.show(patches)
            image = self.painter.paint(camera, mode if still else quick, PATHS)
        if client.client_id not in self._views:
            return  # it has gone away meanwhile
        client.scene.set_background_image(image, "jpeg", jpeg_quality=90 if still else 75)
        self._shown[client.client_id] = key
        if not still:
            self.latencies = [*self.latencies[-99:], time.perf_counter() - begin]

    # ------------------------------------------------------------------ files

    def save(self, suffix: str, client: Any = None) -> Path:
        """Save the net (.vtu), the picture (.png) or the figure (.svg) of a browser's view.

        Raises
        ------
        BezierError
            If it cannot be written, or there is no browser to see it.
        """
        path = self.folder / f"studio{suffix}"
        if suffix == ".vtu":
            save(self.state.patches, path)
        else:
            client = client or next(iter(self._views.values()), None)
            if client is None:
                raise GeometryError.expected("view", "a browser that looks at the page", "none")
            from .. import figures

            camera = camera_of(client.camera, 1600)
            drawing = figures.space(camera)
            patches: BezierTriangles = self.state.patches
            if suffix == ".png":
                with self._brush:
                    self.painter.show(patches)
                    with_light = self.painter.paint(camera, "light", PATHS)
                drawing = figures.overlay(with_light, camera)
            drawing.boundary(patches)
            drawing.isolines(patches, 3)
            drawing.net(patches)
            drawing.save(path)
        self.told.content = f"saved {path.name}"
        return path

    def stop(self) -> None:
        """Close the page."""
        self._stop.set()
        self._wake.set()
        self._worker.join(timeout=10)
        self.server.stop()
