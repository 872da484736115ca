"""Curves on patches: over a segment of the parameters, exactly, of the patch's degree."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import bernstein
from .curves import BezierCurve
from .projective import elements, norm
from .triangles import BezierTriangles

__all__ = ["boundary_curve_of", "isoparametric"]

_CORNERS = np.eye(3)


def isoparametric(patches: BezierTriangles, patch: int, start: Any, end: Any) -> BezierCurve | None:
    """Return the curve of a patch over a segment of its parameters; None if it is a point.

    Parameters
    ----------
    patches : BezierTriangles
    patch : int
    start, end : (3,) array_like
        Barycentric coordinates of the ends of the segment.

    Examples
    --------
    >>> from mitsuba_bezier import figures
    >>> curve = figures.isoparametric(mb.sphere(), 0, (1, 0, 0), (0, 1, 0))
    >>> curve.degree
    4
    """
    net, n = patches.control_points[patch], patches.degree
    a, b = elements("start", start, (3,)), elements("end", end, (3,))
    points = []
    for k in range(n + 1):
        level = net
        for uvw in [a] * (n - k) + [b] * k:
            level = bernstein.blossom_step(level, uvw)
        points.append(level[0])
    out = np.array(points)
    size = norm(out)
    if not size.any():
        return None
    unit = out[size > 0] / size[size > 0, None]
    unit = unit * np.sign(unit @ unit[0])[:, None]
    # 1e-12: an edge that has shrunk to a point, up to rounding
    return None if norm(unit - unit[0]).max() <= 1e-12 else BezierCurve(out)


def boundary_curve_of(patches: BezierTriangles, patch: int, edge: int) -> BezierCurve | None:
    """Return the boundary curve AB, BC or CA (0, 1, 2) of a patch; None if it is a point."""
    return isoparametric(patches, patch, _CORNERS[edge], _CORNERS[(edge + 1) % 3])
