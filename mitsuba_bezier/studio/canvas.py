"""The net before the picture, as nodes of viser's scene, which are moved, not made anew."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .front import Front

__all__ = ["Canvas"]

POINT, CHOSEN = (205, 70, 30), (250, 190, 40)


class Canvas:
    """Points, lines, marks and names in a scene of viser.

    Parameters
    ----------
    scene
        ``server.scene``.
    """

    def __init__(self, scene: Any) -> None:
        self.scene = scene
        scene.set_up_direction("+z")
        scene.world_axes.visible = False
        self.balls: list[Any] = []
        self._lines: dict[str, Any] = {}
        self._marks: dict[str, Any] = {}
        self._names: list[Any] = []
        self._texts: list[str] = []
        self._gizmo: Any = None
        self._gizmo_scale = 0.0

    def clear(self) -> None:
        """Remove everything."""
        for handle in [*self.balls, *self._lines.values(), *self._marks.values(), *self._names]:
            handle.remove()
        self.balls, self._lines, self._marks, self._names, self._texts = [], {}, {}, [], []
        self.gizmo(None, 0.0, None)

    def points(
        self,
        places: list[np.ndarray],
        chooser: Callable[[int], Any],
        dragger: Callable[[int], Any],
        size: float,
    ) -> None:
        """Make the points of another net; each is chosen by a click and moved by a drag."""
        self.clear()
        for row, place in enumerate(places):
            ball = self.scene.add_icosphere(f"/net/{row}", 0.022 * size, POINT, position=place)
            ball.on_click(chooser(row))
            ball.on_drag("left")(dragger(row))
            self.balls.append(ball)

    def write(self, notes: list[tuple[str, np.ndarray]]) -> None:
        """Write names where they belong; all others are removed."""
        if [text for text, _x in notes] != self._texts:
            for handle in self._names:
                handle.remove()
            self._texts = [text for text, _x in notes]
            self._names = [
                self.scene.add_label(f"/names/{k}", text, position=x, font_screen_scale=0.85,
                                     anchor="bottom-left")
                for k, (text, x) in enumerate(notes)
            ]  # fmt: skip
        for handle, (_text, x) in zip(self._names, notes):
            if not np.array_equal(handle.position, x):
                handle.position = x

    def place(self, places: list[np.ndarray], chosen: int) -> None:
        """Put the points where they are; the chosen one is marked."""
        for row, (ball, place) in enumerate(zip(self.balls, places)):
            if not np.array_equal(ball.position, place):
                ball.position = place
            colour = CHOSEN if row == chosen else POINT
            if tuple(ball.color) != colour:
                ball.color = colour

    def show(self, front: Front, size: float) -> None:
        """Draw lines and marks; those that are no more are removed."""
        for name in set(self._lines) - set(front.lines):
            self._lines.pop(name).remove()
        for name, (_pieces, colour, width) in front.lines.items():
            segments = front.segments(name)
            old = self._lines.get(name)
            if old is not None and old.points.shape == segments.shape:
                if not np.array_equal(old.points, segments):
                    old.points = segments
                continue
            self._lines[name] = self.scene.add_line_segments(
                f"/lines/{name}", segments, colour, thickness=width, thickness_units="screen"
            )
        wanted = {f"{name}/{k}": (x, colour) for name, (points, colour) in front.marks.items()
                  for k, x in enumerate(points)}  # fmt: skip
        for name in set(self._marks) - set(wanted):
            self._marks.pop(name).remove()
        for name, (x, colour) in wanted.items():
            if name in self._marks:
                self._marks[name].position = x
            else:
                self._marks[name] = self.scene.add_icosphere(
                    f"/marks/{name}", 0.014 * size, colour, position=x
                )

    def gizmo(self, place: Any, scale: float, pulled: Any) -> None:
        """Show arrows at a place, to move along the axes; None takes them away."""
        if place is None:
            if self._gizmo is not None:
                self._gizmo.remove()
                self._gizmo = None
            return
        if self._gizmo is None or self._gizmo_scale != scale:
            self._gizmo = self.scene.add_transform_controls(
                "/arrows", scale, disable_rotations=True, depth_test=False, position=place
            )
            self._gizmo_scale = scale
            self._gizmo.on_update(pulled)
        elif not np.array_equal(self._gizmo.position, place):
            self._gizmo.position = place
