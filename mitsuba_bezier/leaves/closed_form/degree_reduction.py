"""Nets that are elevations of nets of lower degree: sets of mixed degrees come like that."""

from __future__ import annotations

from functools import cache

import numpy as np

from ...geometry import bernstein
from ...geometry.triangles import BezierTriangles
from .fits import local_nets

__all__ = ["reduce_degree"]

#: How far an elevation may be from the net, relative to its size: five roundings of float32, as a
#: net may have come through Mitsuba's tensors.
_TOLERANCE = 3e-7


@cache
def _matrices(n: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the elevation from degree `m` to `n`, and the least squares inverse."""
    up = bernstein.elevation_matrix(m, n)
    return up, np.linalg.pinv(up)


def reduce_degree(
    patches: BezierTriangles, degree: int
) -> tuple[np.ndarray, BezierTriangles | None, np.ndarray]:
    """Find patches that are elevations of nets of degree `degree`, and these nets.

    Parameters are the same before and after.

    Returns
    -------
    found : (P,) bool array
    nets : BezierTriangles or None
        Of those found.
    residual : array
        How far off the elevations of these are, relative to the patches' sizes.
    """
    up, down = _matrices(patches.degree, degree)
    local, _shift, _size = local_nets(patches)
    residual = np.abs(up @ (down @ local) - local).max(axis=(1, 2))
    found = residual <= _TOLERANCE
    lower = BezierTriangles(down @ patches.control_points[found]) if found.any() else None
    return found, lower, residual[found]
