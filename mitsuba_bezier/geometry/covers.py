"""Closed covers of the sphere by rational Bézier triangles."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from ..errors import GeometryError
from . import bernstein
from .quadrics import quadric_patch
from .triangles import BezierTriangles

__all__ = ["octants", "sphere", "tetrahedral"]

_UNIT_SPHERE = np.diag([1.0, 1.0, 1.0, -1.0])


def octants() -> BezierTriangles:
    """Return the eight octants of the unit sphere as quartic patches.

    Farin, Piper, Worsey, "The octant of a sphere as a non-degenerate triangular Bézier patch",
    CAGD 4 (1987).
    """
    r2, r3 = np.sqrt(2.0), np.sqrt(3.0)
    a = (r3 - 1) / r3
    b = (r3 + 1) / (2 * r3)
    c = 1 - (5 - r2) * (7 - r3) / 46
    weight = {4: 4 * r3 * (r3 - 1), 3: 3 * r2, 2: 4.0}
    w211 = r2 / r3 * (3 + 2 * r2 - r3)
    net = np.zeros((15, 4))
    for r, ijk in enumerate(bernstein.multi_indices(4)):
        top = int(ijk.max())
        if top == 2 and ijk.min() == 1:
            point, w = np.where(ijk == 2, 1.0, c), w211
        else:
            point = np.select([ijk == 4, ijk == 3, ijk == 2, ijk == 1], [1.0, 1.0, b, a], 0.0)
            w = weight[top]
        net[r] = [*(w * point), w]
    nets = []
    flip = bernstein.permutation(4, (0, 2, 1))
    for x in (1, -1):
        for y in (1, -1):
            for z in (1, -1):
                mirrored = net * [x, y, z, 1]
                nets.append(mirrored if x * y * z > 0 else mirrored[flip])
    return BezierTriangles(nets)


def tetrahedral() -> BezierTriangles:
    """Return the unit sphere as four quadratic faces (first) and six quadratic lunes.

    The face opposite a corner of the regular tetrahedron is projected from that corner; a lune
    fills the gap between the arcs of two faces over one edge.
    """
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3.0)
    triples = [(1, 3, 2), (0, 2, 3), (0, 3, 1), (0, 1, 2)]  # outward, opposite corner 0 .. 3
    nets = [face(corners[list(t)], corners[k]) for k, t in enumerate(triples)]
    for i, j in combinations(range(4), 2):
        k, l = (m for m in range(4) if m not in (i, j))
        nets.append(lune(corners[i], corners[j], corners[k], corners[l]))
    return BezierTriangles(nets)


def face(corners: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Return the net ``(6, 4)`` of three points of the unit sphere projected from another.

    The corner weights are 1, so that arcs have their standard parameters.
    """
    # b_ii has the weight 2 (1 - S.P) times the square of the factor of P
    factor = np.sqrt(0.5 / (1 - corners @ center))
    points = np.hstack([corners, np.ones((3, 1))]) * factor[:, None]
    return quadric_patch(_UNIT_SPHERE, np.append(center, 1.0), points)


def lune(start: np.ndarray, end: np.ndarray, left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the net ``(6, 4)`` of the lune between two arcs of circles on the unit sphere.

    The arcs lead from `start` to `end`, in the planes with the points `left` and `right` of
    the sphere, avoiding these. The patch is oriented outwards.
    """
    chord = end - start
    tangents = []
    for other in (left, right):
        # the tangent of the circle lies in its plane and is orthogonal to the radius
        t = np.cross(np.cross(chord, other - start), start)
        t *= np.linalg.norm(chord) / np.linalg.norm(t)
        tangents.append(t if t @ chord > 0 else -t)
    if np.linalg.det([*tangents, start]) > 0:  # from `end`, the left arc comes first
        tangents.reverse()
    points = np.array([[*end, 1.0], [*tangents[0], 0.0], [*tangents[1], 0.0]])
    return quadric_patch(_UNIT_SPHERE, np.append(start, 1.0), points) / (chord @ chord)


def sphere(center: Any = (0, 0, 0), radius: float = 1, cover: str = "octants") -> BezierTriangles:
    """Return a sphere as an exact, closed cover, oriented outwards.

    Parameters
    ----------
    center : (3,) array_like
        Centre, in scene units.
    radius : float
        Radius, positive.
    cover : {"octants", "tetrahedral"}
        Eight quartic patches, or four quadratic faces and six quadratic lunes.

    Raises
    ------
    GeometryError
        If a parameter is not of this form.
    """
    makers = {"octants": octants, "tetrahedral": tetrahedral}
    if cover not in makers:
        raise GeometryError.expected("cover", 'one of "octants", "tetrahedral"', repr(cover))
    c = np.asarray(center, dtype=np.float64)
    if c.shape != (3,) or not np.isfinite(c).all():
        raise GeometryError.expected("center", "three finite numbers", f"{center}")
    r = np.asarray(radius, dtype=np.float64)
    if r.shape != () or not np.isfinite(r) or not r > 0:
        raise GeometryError.expected("radius", "a positive number", f"{radius}")
    matrix = np.diag([r, r, r, 1.0])
    matrix[:3, 3] = c
    return makers[cover]().transform(matrix)
