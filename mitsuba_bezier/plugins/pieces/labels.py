"""Text in scenes: letters as exact plane patches, from the outlines of a font."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from ...errors import GeometryError
from ...geometry.checks import length, vector
from ...geometry.plane_fill import fill_region
from ...geometry.triangles import BezierTriangles
from ...io.fonts import text_outlines
from ..native.dictionaries import shape

__all__ = ["label", "text_patches"]

#: Where the point of a text lies in it: fractions of its width, and of a capital's height.
ANCHORS = {
    "left": (0.0, 0.5), "center": (0.5, 0.5), "right": (1.0, 0.5),
    "below": (0.5, 1.0), "above": (0.5, 0.0), "start": (0.0, 0.0),
}  # fmt: skip

INK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.02, 0.02, 0.02]}}


def text_patches(
    text: str,
    at: Any = (0, 0, 0),
    size: float = 1.0,
    right: Any = (1, 0, 0),
    up: Any = (0, 0, 1),
    anchor: str = "center",
    font: str | os.PathLike[str] | None = None,
) -> BezierTriangles:
    """Return a line of text as Bézier triangles in a plane.

    A letter is what its outline, made of quadratic (TrueType) or cubic curves, bounds: it is filled
    exactly, and round at any size.

    Parameters
    ----------
    text : str
        Characters of the font.
    at : (3,) array_like
        Where its anchor is.
    size : float
        Distance from line to line; a capital is some 0.73 of it.
    right, up : (3,) array_like
        Direction of writing, and of the letters' stems; made orthonormal. The text is read from
        where ``right x up`` points.
    anchor : {"center", "left", "right", "above", "below", "start"}
        "above": the text stands above its point.
    font : path, optional
        A file .ttf or .otf; DejaVu Sans if not given.

    Raises
    ------
    GeometryError
        If the font has not a character, or a parameter is not of this kind.
    FileFormatError, RuntimeSetupError
        If the file is no font, or fontTools is missing.
    """
    x, r, u = vector("at", at), vector("right", right), vector("up", up)
    s = length("size", size)
    if anchor not in ANCHORS:
        raise GeometryError.expected("anchor", "one of " + ", ".join(ANCHORS), repr(anchor))
    if not np.linalg.norm(np.cross(r, u)) > 1e-12 * np.linalg.norm(r) * np.linalg.norm(u):
        raise GeometryError.expected("right, up", "independent directions", f"{right}, {up}")
    r = r / np.linalg.norm(r)
    u = u - (u @ r) * r
    u = u / np.linalg.norm(u)
    contours, (width, capital) = text_outlines(text, font)
    place = np.eye(4)
    place[:3, :3] = s * np.stack([r, u, np.cross(r, u)], axis=1)
    fx, fy = ANCHORS[anchor]
    place[:3, 3] = x - s * (fx * width * r + fy * capital * u)
    return fill_region(contours).transform(place)


def label(
    text: str, at: Any, size: float, bsdf: Any = None, name: str = "label", **options: Any
) -> dict[str, Any]:
    """Return a line of text as a shape of a scene; see `text_patches`.

    Parameters
    ----------
    text, at, size
        As for `text_patches`.
    bsdf : dict, optional
        Material; dark, seen from both sides, if not given.
    name : str
        Key of the shape: one for each label of a scene.
    **options
        ``right``, ``up``, ``anchor``, ``font`` of `text_patches`.

    Examples
    --------
    >>> scene = {"type": "scene", **label("S", (0, 0, 1.1), 0.2)}
    >>> scene["label"]["type"]
    'beziertriangle'
    """
    ink = {"type": "twosided", "bsdf": INK} if bsdf is None else bsdf
    return {name: shape(text_patches(text, at, size, **options), bsdf=ink)}
