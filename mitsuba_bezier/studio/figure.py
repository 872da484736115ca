"""Figures in the studio: drawings whose numbers run by sliders, and drawings of what is seen."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GeometryError
from ..geometry.camera import Camera
from ..geometry.curves import BezierCurve
from ..geometry.projective import point
from .front import Front
from .presets import arguments_of
from .state import State

__all__ = ["Drawn", "view_drawing"]


class Drawn:
    """A figure of the lecture that is shown as a drawing.

    Parameters
    ----------
    name : str
        One of `drawings`.
    """

    def __init__(self, name: str) -> None:
        from .. import figures

        self.name = name
        self.arguments = arguments_of(name)
        #: numbers that were moved; all others are the figure's own
        self.values: dict[str, float] = {}
        self.says = figures.names()[name]
        self._kept: tuple[Any, Any] | None = None

    @property
    def key(self) -> tuple[Any, ...]:
        """What tells one picture from another."""
        return self.name, *sorted(self.values.items())

    def move(self, name: str, value: float) -> None:
        """Give a number another value; if the figure refuses it, the last one stays.

        Raises
        ------
        BezierError
            If the figure refuses it.
        """
        if name not in [a.name for a in self.arguments]:
            raise GeometryError.expected("name", "a number of the figure", repr(name))
        values = {**self.values, name: value}
        self._drawing(values)
        self.values = values

    def _drawing(self, values: dict[str, float]) -> Any:
        from .. import figures

        if self._kept is None or self._kept[0] != values:
            self._kept = dict(values), figures.draw(self.name, "screen", **values)
        return self._kept[1]

    def picture(self, width: int, aspect: float, free: float = 0.0) -> np.ndarray:
        """Return the drawing in a white picture of some proportions, ``(h, w, 3)``.

        Parameters
        ----------
        width : int
            Pixels of the longer side.
        aspect : float
            Width over height.
        free : float
            Part of a wide picture, on the right, that stays white.
        """
        from PIL import Image

        wide = width if aspect >= 1 else max(round(width * aspect), 16)
        high = max(round(wide / aspect), 16)
        room = round(wide * (1 - min(free, 0.5))) if aspect >= 0.8 else wide
        data = self._drawing(self.values).encoded(".png", max(room, 320))
        with Image.open(io.BytesIO(data)) as opened:
            drawing = opened.convert("RGB")
        scale = min(room / drawing.width, high / drawing.height)
        size = max(round(drawing.width * scale), 1), max(round(drawing.height * scale), 1)
        out = Image.new("RGB", (wide, high), (255, 255, 255))
        # in a high window above, where the controls leave it free
        corner = (room - size[0]) // 2, (high - size[1]) // (2 if aspect >= 0.8 else 5)
        out.paste(drawing.resize(size, Image.Resampling.LANCZOS), corner)
        return np.array(out)

    def save(self, path: Path) -> None:
        """Write the drawing."""
        self._drawing(self.values).save(path)


#: Roles of lines that stand before the picture.
_KINDS = {"image": "second", "tangents": "tangent", "vectors": "tangent", "rest": "construction"}


def view_drawing(state: State, front: Front, camera: Camera, image: np.ndarray | None) -> Any:
    """Return a drawing of what a browser sees: the net, the curves, and a picture behind.

    Parameters
    ----------
    state : State
    front : Front
        What stands before the picture.
    camera : Camera
    image : (h, w, 3) array, optional
        Picture of this camera.
    """
    from .. import figures

    drawing = figures.space(camera) if image is None else figures.overlay(image, camera)
    if not state.curve:
        patches = state.patches
        if image is None:
            drawing.surface(patches, 40)
        drawing.isolines(patches, 3)
        drawing.boundary(patches)
        drawing.net(patches, labels=True)
    else:
        curve = BezierCurve(state.net)
        drawing.control_polygon(curve)
        drawing.curve(curve)
    for name, (pieces, _colour, _width) in front.lines.items():
        if name in ("legs", "boundary", "curve"):
            continue
        kind = "construction" if name.startswith("scheme") else _KINDS.get(name, "thin")
        seen = [x for x in pieces if (camera.image(point(x))[:, 2] > 0).all()]
        drawing._stroke([drawing.place(x) for x in seen], kind)
    for points, _colour in front.marks.values():
        drawing.points(points, kind="second point", markersize=5.0)
    return drawing
