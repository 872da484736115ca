"""Building blocks of the lecture's models: flat patches, prisms to the horizon, tubes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any

import numpy as np

from mitsuba_bezier.geometry.triangles import BezierTriangles

__all__ = ["TRACK", "boxes", "prism", "quads", "segment", "tube"]

#: Direction of the track; its ideal point is a control vector of every rail.
TRACK = np.array([0.0, 1.0, 0.0])


def quads(corners: Any) -> BezierTriangles:
    """Return plane quadrilaterals ``(N, 4, 3)`` as two linear patches each.

    Corners run counter-clockwise as seen from the side of the normal.
    """
    x = np.asarray(corners, dtype=np.float64).reshape(-1, 4, 3)
    x = np.concatenate([x, np.ones((*x.shape[:2], 1))], axis=-1)
    return BezierTriangles(x[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 4))


#: The faces of a box as numbers of its corners, outwards: bottom, top, and the four sides.
_FACES = {
    "-z": (0, 2, 3, 1), "+z": (4, 5, 7, 6),
    "-y": (0, 1, 5, 4), "+y": (2, 6, 7, 3),
    "-x": (0, 4, 6, 2), "+x": (1, 3, 7, 5),
}  # fmt: skip


def boxes(lower: Any, upper: Any, faces: Iterable[str] = tuple(_FACES)) -> BezierTriangles:
    """Return axis-aligned boxes, twelve linear patches each (or fewer faces), outwards.

    Parameters
    ----------
    lower, upper : (N, 3) array_like
        Opposite corners.
    faces : iterable of str
        Which faces: "-x", "+x", ...
    """
    lo, hi = np.atleast_2d(lower), np.atleast_2d(upper)
    bits = np.array([[(k >> c) & 1 for c in range(3)] for k in range(8)], dtype=bool)
    corners = np.where(bits, hi[:, None], lo[:, None])
    return quads(corners[:, [_FACES[f] for f in faces]])


def prism(section: Any, start: float) -> BezierTriangles:
    """Return the half-infinite prism over an open polygon, along +y to the horizon.

    Each side is one linear patch with two corners at y = `start` and the third in the ideal
    point of the y axis.

    Parameters
    ----------
    section : (N, 2) array_like
        Vertices ``(x, z)``; the outside is on the left of the polygon's way, seen along +y.
    start : float
        The y of the front end, which is open.
    """
    p = np.asarray(section, dtype=np.float64)
    ends = np.column_stack([p[:, 0], np.full(len(p), start), p[:, 1], np.ones(len(p))])
    ideal = np.array([*TRACK, 0.0])
    return BezierTriangles([[ideal, a, b] for a, b in pairwise(ends)])


def tube(curve: Callable[[np.ndarray], np.ndarray], count: int, radius: float) -> np.ndarray:
    """Return control points ``(count + 3, 4)`` of a cubic B-spline along a curve.

    Parameters
    ----------
    curve : callable
        Points ``(N, 3)`` for parameters ``(N,)``; the curve is drawn over [0, 1] and
        sampled a little beyond.
    count : int
        Number of segments.
    radius : float
        Radius of the tube, the fourth column.

    Returns
    -------
    (count + 3, 4) array
        Rows ``x, y, z, radius``. The quasi-interpolant ``p_i - (p_{i-1} - 2 p_i + p_{i+1}) / 6``
        differs from the curve by the fourth power of the spacing.
    """
    p = curve(np.arange(-2, count + 3) / count)
    c = p[1:-1] - (p[:-2] - 2 * p[1:-1] + p[2:]) / 6
    return np.column_stack([c, np.full(len(c), radius)])


def segment(a: Any, b: Any, radius: float) -> np.ndarray:
    """Return the control points of a straight tube, see `tube`."""
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    return tube(lambda t: a + np.multiply.outer(t, b - a), 1, radius)
