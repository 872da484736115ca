"""Unroll a developable into the plane, by bending that keeps every length.

A strip of triangles between neighbouring rulings is bent along its edges: a vertex keeps its
distances to the two before it, and the angle between two triangles is scaled. So lengths and areas
of the strip stay to rounding at every stage; the strip is as close to the surface as the square
of its step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .developable import DevelopableSurface
from .projective import affine, count, number

__all__ = ["strip", "strip_faces", "unrolled"]


def strip(surface: DevelopableSurface, first: Any, second: Any, rulings: int = 200) -> np.ndarray:
    """Return the ends of rulings on two planes, in turn: ``(2 * rulings, 3)``.

    Parameters
    ----------
    surface : DevelopableSurface
    first, second : (4,) array_like
        The planes that bound it.
    rulings : int
        How many, at least 2.

    Raises
    ------
    GeometryError
        As `DevelopableSurface.trace`, or if an end is at infinity or both ends coincide.
    """
    t = np.linspace(0, 1, count(rulings, "rulings", 2))
    ends = [affine(surface.trace(plane).evaluate(t)) for plane in (first, second)]
    if not (np.linalg.norm(ends[0] - ends[1], axis=1) > 0).all():
        raise GeometryError.expected("first, second", "rulings with a length", "one without")
    return np.stack(ends, axis=1).reshape(-1, 3)


def strip_faces(count: int) -> np.ndarray:
    """Return the triangles ``(count - 2, 3)`` of a strip of `count` vertices, one orientation."""
    k = np.arange(count - 2)
    odd = k % 2
    return np.stack([k, k + 1 + odd, k + 2 - odd], axis=1)


def unrolled(vertices: Any, bend: float = 0.0) -> np.ndarray:
    """Return a strip bent to a fraction of its angles: 1 as it is, 0 flat; lengths stay.

    Parameters
    ----------
    vertices : (n, 3) array_like
        Of a strip of triangles, as `strip` returns them.
    bend : float
        Factor of the angles between neighbouring triangles.

    Returns
    -------
    (n, 3) array
        The middle triangle stays where it is.

    Raises
    ------
    GeometryError
        If there are fewer than three vertices, or three successive ones on a line.
    """
    x = np.asarray(vertices, dtype=np.float64)
    if x.ndim != 2 or x.shape[1] != 3 or len(x) < 3 or not np.isfinite(x).all():
        raise GeometryError.expected("vertices", "finite (n, 3), n >= 3", f"shape {x.shape}")
    factor = number(bend, "bend")
    middle = (len(x) - 3) // 2
    out = np.zeros_like(x)
    out[middle : middle + 3] = x[middle : middle + 3]
    for k in range(middle + 3, len(x)):
        out[k] = _next(x[k - 3 : k + 1], out[k - 3 : k], factor)
    for k in range(middle - 1, -1, -1):
        out[k] = _next(x[k : k + 4][::-1], out[k + 1 : k + 4][::-1], factor)
    return out


def _frame(
    p: np.ndarray, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the unit vector along an edge, that across it away from `p`, and the normal."""
    e = (b - a) / np.linalg.norm(b - a)
    across = a - p
    across = across - (across @ e) * e
    size = np.linalg.norm(across)
    if not size > 1e-12 * np.linalg.norm(a - p):
        raise GeometryError.expected("vertices", "triangles", "three vertices on a line")
    across = across / size
    return e, across, np.cross(e, across)


def _next(old: np.ndarray, new: np.ndarray, factor: float) -> np.ndarray:
    """Return where the fourth of four vertices goes when the first three have gone to `new`."""
    e, across, normal = _frame(old[0], old[1], old[2])
    d = old[3] - old[1]
    along, u, v = d @ e, d @ across, d @ normal
    radius, angle = np.hypot(u, v), factor * np.arctan2(v, u)
    e, across, normal = _frame(new[0], new[1], new[2])
    return new[1] + along * e + radius * (np.cos(angle) * across + np.sin(angle) * normal)
