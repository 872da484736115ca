"""Drawings of projective geometry on matplotlib: in the plane, in space, and over renders.

Needs the extra ``figures``. A drawing takes homogeneous coordinates, so that control points may lie
at infinity; in space it is seen by a `Camera`, and lies exactly over a render of that camera.

    from mitsuba_bezier import BezierCurve, figures

    drawing = figures.plane((-0.5, 4.5), (-0.5, 2.5))
    curve = BezierCurve.from_points([[0, 0], [1, 2], [3, 2], [4, 0]])
    drawing.de_casteljau(curve, 0.25)
    drawing.curve(curve)
    drawing.save("scheme.svg")

`draw` makes one of the lecture's figures by its name, with weights, parameters and angles as
arguments; `mitsuba-bezier figure` is the same as a command.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from ..errors import GeometryError
from ..geometry.camera import Camera
from ..geometry.isoparametric import isoparametric
from ..geometry.projective import number, numbers
from .drawing import SUFFIXES, camera_window
from .sampling import Window
from .schemes import Schemes

__all__ = ["SUFFIXES", "Drawing", "draw", "isoparametric", "names", "overlay", "plane", "space"]


class Drawing(Schemes):
    """A drawing of the plane (`plane`), of space (`space`), or over a render (`overlay`).

    Examples
    --------
    >>> from mitsuba_bezier import figures
    >>> drawing = figures.plane((-0.5, 4.5), (-0.5, 2.5))
    >>> drawing.curve(mb.BezierCurve.from_points([[0, 0], [1, 2], [3, 2], [4, 0]]))
    >>> drawing.save("curve.svg")
    """


def plane(x: Any, y: Any, style: str = "screen") -> Drawing:
    """Return an empty drawing of the plane.

    Parameters
    ----------
    x, y : pair of float
        Range that is shown. Both axes have one scale: the ranges make the proportions.
    style : {"screen", "print"}
        With some dark colours, or black and grey alone.

    Raises
    ------
    GeometryError
        If a range is none.
    RuntimeSetupError
        Without the extra ``figures``.

    Examples
    --------
    >>> from mitsuba_bezier import figures
    >>> drawing = figures.plane((0, 4), (0, 2), style="print")
    >>> drawing.point([1, 1], "P")
    >>> drawing.save("point.pdf")
    """
    a, b = numbers(x, "x"), numbers(y, "y")
    for name, r in (("x", a), ("y", b)):
        if r.shape != (2,) or not r[0] < r[1]:
            raise GeometryError.expected(name, "a range of two numbers that rise", f"{r.tolist()}")
    window = Window(float(a[0]), float(a[1]), float(b[0]), float(b[1]))
    return Drawing(window, np.eye(3), style, down=False)


def space(camera: Camera, style: str = "screen") -> Drawing:
    """Return an empty drawing of space as a camera sees it, in the pixels of its film.

    Examples
    --------
    >>> from mitsuba_bezier import figures
    >>> to_world = mi.ScalarTransform4f().look_at([0, -5, 2], [0, 0, 0], [0, 0, 1])
    >>> camera = mb.Camera(np.array(to_world.matrix), fov=40, film_size=(320, 240))
    >>> drawing = figures.space(camera)
    >>> drawing.point([0, 0, 0], "origin")
    >>> drawing.save("space.svg")
    """
    if not isinstance(camera, Camera):
        raise GeometryError.expected("camera", "a Camera", f"{type(camera).__name__}")
    return Drawing(camera_window(camera), camera.image_matrix, style, down=True)


def overlay(render: Any, camera: Camera, style: str = "screen", fade: float = 0.0) -> Drawing:
    """Return a drawing of space with a render of the same camera behind it.

    Parameters
    ----------
    render : (h, w, 3 | 4) array_like, or path
        Picture with as many pixels as the camera's film (or its crop window), or the same
        proportions: bytes, or linear numbers as a render has them, which get sRGB's curve. A path
        is read as EXR (linear), PNG, JPEG or WebP.
    camera : Camera
        The camera of the render.
    style : {"screen", "print"}
    fade : float
        From 0 to 1: how far the render is lightened, so that lines and text stand out.

    Raises
    ------
    GeometryError
        If the picture has other proportions than the film.

    Examples
    --------
    >>> from mitsuba_bezier import figures
    >>> to_world = mi.ScalarTransform4f().look_at([0, -5, 2], [0, 0, 0], [0, 0, 1])
    >>> camera = mb.Camera(np.array(to_world.matrix), fov=40, film_size=(32, 24))
    >>> drawing = figures.overlay(np.full((24, 32, 3), 0.5), camera, fade=0.5)
    >>> drawing.save("over.png")
    """
    drawing = space(camera, style)
    picture = _picture(render)
    height, width = picture.shape[:2]
    w, h = camera.crop_size
    # a pixel of the picture more or less is another film
    if abs(width * h - height * w) > max(w, h) / 2:
        raise GeometryError.expected(
            "render", f"a picture of {w:g} x {h:g} pixels, as the film", f"{width} x {height}"
        )
    if not 0 <= fade <= 1:
        raise GeometryError.expected("fade", "a number from 0 to 1", fade)
    shown = picture + (255 - picture.astype(np.float64)) * fade
    drawing.axes.imshow(
        shown.round().astype(np.uint8), extent=(0, w, h, 0), interpolation="antialiased",
        aspect="auto", zorder=0,
    )  # fmt: skip
    drawing.axes.set_xlim(0, w)
    drawing.axes.set_ylim(h, 0)
    return drawing


def _picture(render: Any) -> np.ndarray:
    """Return a picture as bytes ``(h, w, 3)``."""
    if isinstance(render, (str, os.PathLike)):
        from .styles import matplotlib

        matplotlib()
        from PIL import Image

        try:
            if os.fspath(render).lower().endswith(".exr"):
                return _picture(_exr(os.fspath(render)))
            with Image.open(render) as image:
                return np.array(image.convert("RGB"))
        except (OSError, ValueError, RuntimeError, KeyError) as error:
            raise GeometryError.expected("render", "a picture", error) from None
    a = np.asarray(render)
    if a.ndim == 2:
        a = np.repeat(a[..., None], 3, axis=2)
    if a.ndim != 3 or a.shape[2] not in (3, 4) or a.dtype.kind not in "uif":
        raise GeometryError.expected("render", "an array (h, w, 3)", f"shape {a.shape}")
    a = a[..., :3]
    if a.dtype == np.uint8:
        return a
    x = np.clip(np.nan_to_num(a.astype(np.float64)), 0, 1)
    x = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return (255 * x).round().astype(np.uint8)


def _exr(path: str) -> np.ndarray:
    """Return the colours of an EXR file, linear, ``(h, w, 3)``."""
    import OpenEXR

    with OpenEXR.File(path) as file:
        channels = file.channels()
        for name in ("RGB", "RGBA"):
            if name in channels:
                return np.asarray(channels[name].pixels, dtype=np.float64)[..., :3]
        names = ("R", "G", "B") if "R" in channels else ("Y",) * 3
        return np.stack([np.asarray(channels[c].pixels, dtype=np.float64) for c in names], axis=2)


def names() -> dict[str, str]:
    """Return the lecture's figures: their names, and what each shows.

    Examples
    --------
    >>> from mitsuba_bezier import figures
    >>> "decasteljau" in figures.names()
    True
    """
    from .catalogue import CATALOGUE

    return {name: (make.__doc__ or "").strip().splitlines()[0] for name, make in CATALOGUE.items()}


def draw(name: str, style: str = "screen", **arguments: Any) -> Drawing:
    """Return one of the lecture's figures, drawn.

    Parameters
    ----------
    name : str
        One of `names`.
    style : {"screen", "print"}
    **arguments
        Weights, parameters, angles: what its function takes, all with defaults.

    Raises
    ------
    GeometryError
        If there is no such figure, or it does not take an argument, or not this value.

    Examples
    --------
    >>> from mitsuba_bezier import figures
    >>> figures.draw("decasteljau", t=0.7).save("scheme.svg")
    """
    import inspect

    from .catalogue import CATALOGUE

    if name not in CATALOGUE:
        raise GeometryError.expected("name", "one of " + ", ".join(CATALOGUE), repr(name))
    make = CATALOGUE[name]
    known = [p for p in inspect.signature(make).parameters if p != "style"]
    for key, value in arguments.items():
        if key not in known:
            what = "one of " + ", ".join(known) if known else "no argument"
            raise GeometryError.expected(f"argument of {name}", what, repr(key))
        if value is not None:
            number(value, key)
    return make(style=style, **arguments)
