"""`Drawing`: points, lines, curves and text on matplotlib, by homogeneous coordinates.

One class for the plane and for space. Whatever is drawn goes through one matrix to the drawing
plane: the identity for a plane drawing, the image matrix of a `Camera` for one of space, whose
drawing plane is the camera's film in pixels. So a drawing lies exactly over a render of the same
camera, control points may be at infinity, and curves run through it.
"""

from __future__ import annotations

import io
import os
from typing import Any

import numpy as np

from .._files import write_file
from ..errors import GeometryError
from ..geometry.bernstein import univariate
from ..geometry.camera import Camera
from ..geometry.conics import conic_arcs
from ..geometry.curves import BezierCurve
from ..geometry.projective import elements, norm, numbers, point
from ..geometry.splines import BSplineCurve
from .sampling import Window, trace
from .styles import font, matplotlib, role

__all__ = ["SUFFIXES", "Canvas"]

#: What `save` writes.
SUFFIXES = (".svg", ".pdf", ".png", ".webp", ".jpg")

#: Width of the drawing in inches: line widths and text are made for it.
INCHES = 8.0

#: How far polylines may be from their curves, in pixels of 1600 across.
FINE = 0.05


class Canvas:
    """What `Drawing` draws with: elements of the plane or of space.

    Parameters
    ----------
    window : Window
        What is shown, in coordinates of the drawing plane.
    matrix : (3, c) array
        From homogeneous coordinates to those of the drawing plane.
    style : {"screen", "print"}
        With some dark colours, or black and grey alone.
    down : bool
        The second coordinate grows downwards, as pixels do.
    """

    def __init__(self, window: Window, matrix: np.ndarray, style: str, down: bool) -> None:
        mpl = matplotlib()
        role("curve", style)  # is there such a style?
        self.window, self.matrix, self.style, self.down = window, matrix, style, down
        width, height = window.size
        with mpl.rc_context(font()):
            self.figure = mpl.figure.Figure(figsize=(INCHES, INCHES * height / width))
            self.axes = self.figure.add_axes((0, 0, 1, 1))
        self.axes.set_axis_off()
        self.axes.set_xlim(window.x0, window.x1)
        self.axes.set_ylim(*((window.y1, window.y0) if down else (window.y0, window.y1)))
        self.tolerance = FINE * width / 1600

    # ------------------------------------------------------------------ the map

    @property
    def dimension(self) -> int:
        """2 for a drawing of the plane, 3 for one of space."""
        return self.matrix.shape[1] - 1

    def homogeneous(self, points: Any, name: str = "points") -> np.ndarray:
        """Return points as homogeneous ``(..., c)``: Euclidean ones get the weight 1.

        Raises
        ------
        GeometryError
            If they have another number of coordinates.
        """
        x = numbers(points, name)
        d = self.dimension
        if x.ndim and x.shape[-1] == d:
            return point(x)
        if x.ndim and x.shape[-1] == d + 1:
            return elements(name, x, (d + 1,))
        raise GeometryError.expected(
            name, f"{d} coordinates a point, or {d + 1} homogeneous ones", f"shape {x.shape}"
        )

    def image(self, points: Any) -> np.ndarray:
        """Return homogeneous points of the drawing plane ``(..., 3)``."""
        return self.homogeneous(points) @ self.matrix.T

    def place(self, points: Any) -> np.ndarray:
        """Return where points are drawn, ``(..., 2)``.

        Raises
        ------
        GeometryError
            If one has no place: at infinity, or in the plane of the eye.
        """
        h = self.image(points)
        if (np.abs(h[..., 2]) <= 1e-12 * norm(h)).any():
            raise GeometryError.expected("points", "points with a place in the drawing", "others")
        return h[..., :2] / h[..., 2:]

    def _net(self, net: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Return a net in the drawing plane, and the polynomial that is positive before the eye."""
        image = net @ self.matrix.T
        if self.dimension == 2:
            return image, None
        # depth is the weight of the image over that of the point
        n = len(net) - 1
        t = (1 - np.cos(np.pi * (np.arange(2 * n + 1) + 0.5) / (2 * n + 1))) / 2
        b = univariate(n, t)
        values = (b @ image[:, 2]) * (b @ net[:, -1])
        if not np.abs(net[:, -1]).any():
            values = b @ image[:, 2]  # all at infinity: directions before the eye
        return image, np.linalg.solve(univariate(2 * n, t), values)

    # ------------------------------------------------------------------ what is drawn

    def _stroke(self, pieces: list[np.ndarray], kind: str, **changes: Any) -> None:
        look = role(kind, self.style, **changes)
        for x in pieces:
            self.axes.plot(*x.T, solid_capstyle="round", dash_capstyle="butt", snap=False, **look)

    def curve(
        self, curve: Any, kind: str = "curve", start: float = 0.0, end: float = 1.0, **changes: Any
    ) -> None:
        """Draw a Bézier or B-spline curve, also through infinity.

        Parameters
        ----------
        curve : BezierCurve or BSplineCurve
            In the plane, or in space.
        kind : str
            Role, such as "curve", "second", "polygon", "construction".
        start, end : float
            Parameters of a Bézier curve; beyond [0, 1] the rest of a conic.
        **changes
            Keywords of matplotlib's lines: ``linewidth``, ``color``, ``linestyle``.

        Raises
        ------
        GeometryError
            If it is no curve, or one of another dimension.
        """
        pieces = curve.to_bezier() if isinstance(curve, BSplineCurve) else [curve]
        for piece in pieces:
            if not isinstance(piece, BezierCurve) or piece.dimension != self.dimension:
                raise GeometryError.expected(
                    "curve", f"a curve of dimension {self.dimension}", f"{piece!r}"
                )
            net, sign = self._net(piece.control_points)
            self._stroke(trace(net, self.window, self.tolerance, sign, start, end), kind, **changes)

    def segment(self, a: Any, b: Any, kind: str = "line", **changes: Any) -> None:
        """Draw the segment between two points, or to the vanishing point of an ideal one."""
        ends = np.stack([self.homogeneous(x, n) for x, n in ((a, "a"), (b, "b"))])
        ends = ends * np.where(ends[:, -1:] < 0, -1.0, 1.0)  # the finite segment
        net, sign = self._net(ends)
        self._stroke(trace(net, self.window, self.tolerance, sign), kind, **changes)

    def polyline(
        self, points: Any, kind: str = "polygon", closed: bool = False, **changes: Any
    ) -> None:
        """Draw the segments between successive points."""
        p = self.homogeneous(points)
        for a, b in zip(p, np.roll(p, -1, axis=0) if closed else p[1:]):
            self.segment(a, b, kind, **changes)

    def line(self, a: Any, b: Any = None, kind: str = "line", **changes: Any) -> None:
        """Draw the whole line: of two points, or in the plane ``(3,)`` of its coordinates.

        Raises
        ------
        GeometryError
            If it is not of this form. The ideal line of the plane has no place and is not drawn.
        """
        if b is None:
            if self.dimension != 2:
                raise GeometryError.expected("b", "a second point of a line of space", "none")
            own = elements("line", a, (3,))
            if norm(own[:2]) <= 1e-12 * norm(own):
                return
            p = np.append(-own[2] * own[:2] / (own[:2] @ own[:2]), 1.0)
            d = np.array([own[1], -own[0], 0.0])
        else:
            p, q = self.homogeneous(a, "a"), self.homogeneous(b, "b")
            d = p[-1] * q - q[-1] * p  # the ideal point
            if abs(p[-1]) <= 1e-12 * norm(p):
                p, d = q, p
            elif not d.any():
                raise GeometryError.expected("a, b", "two different points", "one twice")
            p = p / p[-1] if p[-1] else p
        for way in (1.0, -1.0):
            net, sign = self._net(np.stack([p, way * d]))
            self._stroke(trace(net, self.window, self.tolerance, sign), kind, **changes)

    def conic(self, A: Any, kind: str = "curve", **changes: Any) -> None:
        """Draw a whole conic ``(3, 3)`` of the drawing plane: pixels, in a drawing of space."""
        for arc in conic_arcs(A, 4):
            net = arc.control_points
            self._stroke(trace(net, self.window, self.tolerance), kind, **changes)

    def fill(
        self, points: Any, grey: float = 0.85, hatch: str | None = None, **changes: Any
    ) -> None:
        """Fill a polygon whose corners have places in the drawing."""
        look = {"color": f"{grey}", "linewidth": 0.0, "zorder": 1, **changes}
        if hatch:
            look = {"facecolor": "none", "edgecolor": "0.4", "linewidth": 0.0, "zorder": 1}
            look = {**look, "hatch": hatch, **changes}
        self.axes.fill(*self.place(points).T, **look)

    def point(
        self,
        at: Any,
        label: str | None = None,
        offset: tuple[float, float] = (8, 8),
        kind: str = "point",
        **changes: Any,
    ) -> None:
        """Mark a point; an ideal one by an arrow at the edge, or in space its vanishing point.

        Parameters
        ----------
        at : array_like
            Euclidean or homogeneous.
        label : str, optional
            Text, formulas between dollars as in TeX.
        offset : (2,) of float
            From the point to the text, in points of 1/72 inch, to the right and upwards.
        kind : str
            "point" (full) or "second point" (open).
        """
        h = self.image(at)
        if abs(h[2]) <= 1e-12 * norm(h):
            self._ideal(h[:2], label, offset)
            return
        x = h[:2] / h[2]
        look = role(kind, self.style, **changes)
        self.axes.plot(*x, marker="o", linestyle="none", clip_on=False, **look)
        if label:
            self._write(x, label, offset)

    def points(self, at: Any, labels: Any = None, **changes: Any) -> None:
        """Mark points; `labels` are texts, or a format such as ``"$b_{}$"`` that is numbered."""
        p = self.homogeneous(at)
        for k, x in enumerate(p):
            text = labels.format(k) if isinstance(labels, str) else labels and labels[k]
            self.point(x, text, **changes)

    def _ideal(self, way: np.ndarray, label: str | None, offset: tuple[float, float]) -> None:
        """Mark an ideal point by an arrow from inside to the edge of the window."""
        w = self.window.grown(-0.02)
        half = w.size / 2
        reach = np.min(half / np.maximum(np.abs(way), 1e-300))
        tip = w.middle + reach * way
        tail = w.middle + 0.86 * reach * way
        self.arrow_between(tail, tip, "ideal")
        if label:
            self._write(w.middle + 0.93 * reach * way, label, offset)

    def arrow_between(self, tail: np.ndarray, tip: np.ndarray, kind: str, **changes: Any) -> None:
        """Draw an arrow between two places of the drawing plane."""
        look = role(kind, self.style, **changes)
        zorder = look.pop("zorder")
        look = {"lw": look["linewidth"], "color": look["color"]}
        self.axes.annotate(
            "", tip, tail, zorder=zorder,
            arrowprops={"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, **look},
        )  # fmt: skip

    def arrow(self, a: Any, b: Any, kind: str = "tangent", **changes: Any) -> None:
        """Draw an arrow from one point to another."""
        self.arrow_between(self.place(a), self.place(b), kind, **changes)

    def label(
        self, at: Any, text: str, offset: tuple[float, float] = (0, 0), **changes: Any
    ) -> None:
        """Write at a point; formulas stand between dollars, as in TeX."""
        self._write(self.place(at), text, offset, **changes)

    def _write(self, x: np.ndarray, text: str, offset: tuple[float, float], **changes: Any) -> None:
        effects = matplotlib_effects()
        dx, dy = offset
        look = {"fontsize": 13.5, **role("text", self.style), **changes}
        self.axes.annotate(
            text,
            x,
            (dx, dy),
            textcoords="offset points",
            ha="center" if abs(dx) < 3 else ("left" if dx > 0 else "right"),
            va="center" if abs(dy) < 3 else ("bottom" if dy > 0 else "top"),
            path_effects=[effects.withStroke(linewidth=3.0, foreground="white")],
            annotation_clip=False,
            **look,
        )

    def title(self, text: str, below: bool = False, **changes: Any) -> None:
        """Write one line at the upper (or lower) left edge: what the picture shows."""
        effects = matplotlib_effects()
        look = {"fontsize": 13.0, **role("text", self.style), **changes}
        self.axes.text(
            0.018, 0.025 if below else 0.975, text, transform=self.axes.transAxes,
            ha="left", va="bottom" if below else "top", linespacing=1.35,
            path_effects=[effects.withStroke(linewidth=3.0, foreground="white")],
            bbox={"boxstyle": "square,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.75},
            **{**look, "zorder": 8.5},
        )  # fmt: skip

    # ------------------------------------------------------------------ files

    def encoded(self, suffix: str, width: int = 1600) -> bytes:
        """Return the drawing as a file's bytes.

        Parameters
        ----------
        suffix : str
            One of `SUFFIXES`.
        width : int
            Pixels across, of images of pixels (and of shaded surfaces within an SVG or PDF).

        Raises
        ------
        GeometryError
            If the suffix is none of these, or the width no number of pixels.
        """
        suffix = suffix.lower()
        if suffix not in SUFFIXES:
            raise GeometryError.expected("path", "a suffix " + ", ".join(SUFFIXES), repr(suffix))
        if not (np.ndim(width) == 0 and float(width) == int(width) and 16 <= width <= 32768):
            raise GeometryError.expected("width", "16 to 32768 pixels", width)
        buffer = io.BytesIO()
        metadata: dict[str, Any] = {}
        if suffix == ".svg":
            metadata = {"Date": None, "Creator": "mitsuba_bezier"}
        elif suffix == ".pdf":
            metadata = {"CreationDate": None, "Creator": "mitsuba_bezier"}
        with matplotlib().rc_context(font()):
            more: dict[str, Any] = {"metadata": metadata} if metadata else {}
            if suffix in (".webp", ".jpg"):
                more["pil_kwargs"] = {"quality": 88}
            self.figure.savefig(buffer, format=suffix[1:], dpi=width / INCHES, **more)
        return buffer.getvalue()

    def save(self, path: str | os.PathLike[str], width: int = 1600) -> None:
        """Write the drawing; the suffix tells the format. Errors as for `encoded`."""
        data = self.encoded(os.path.splitext(os.fspath(path))[1], width)
        write_file(path, data, "path", make_folders=True)

    def _repr_png_(self) -> bytes:
        """Return the drawing as notebooks show it."""
        return self.encoded(".png", 1000)

    def pixels(self, width: int = 1600) -> np.ndarray:
        """Return the drawing as an array ``(height, width, 3)`` of bytes."""
        from PIL import Image  # comes with matplotlib

        with Image.open(io.BytesIO(self.encoded(".png", width))) as image:
            return np.array(image.convert("RGB"))


def matplotlib_effects() -> Any:
    """Return matplotlib's module of effects of paths."""
    matplotlib()
    from matplotlib import patheffects

    return patheffects


def camera_window(camera: Camera) -> Window:
    """Return the window of a camera's film (crop window) in pixels."""
    width, height = camera.crop_size
    return Window(0.0, float(width), 0.0, float(height))
