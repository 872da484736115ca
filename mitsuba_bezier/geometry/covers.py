"""Closed covers of the sphere, and of every other oval quadric, by rational Bézier triangles."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from ..errors import GeometryError
from . import bernstein
from .checks import finite_array, length, vector
from .quadric_types import (
    classify_quadric,
    collineation_to_paraboloid,
    normal_form,
    projective_type,
)
from .quadrics import ZERO, project_triangles
from .tensor import tensor_to_triangles
from .triangles import BezierTriangles

__all__ = [
    "arc_tangent",
    "lune_between",
    "lunes",
    "octants",
    "project_faces",
    "quadric_cover",
    "ruled_cover",
    "sphere",
    "sphere_face",
    "sphere_lune",
    "tetrahedral",
]

_UNIT_SPHERE = np.diag([1.0, 1.0, 1.0, -1.0])


def octants() -> BezierTriangles:
    """Return the eight octants of the unit sphere as quartic patches.

    Farin, Piper, Worsey, "The octant of a sphere as a non-degenerate triangular Bézier patch",
    Computer Aided Geometric Design 4 (1987).
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
    nets = [sphere_face(corners[list(t)], corners[k]) for k, t in enumerate(triples)]
    for i, j in combinations(range(4), 2):
        k, l = (m for m in range(4) if m not in (i, j))
        nets.append(sphere_lune(corners[i], corners[j], corners[k], corners[l]))
    return BezierTriangles(nets)


def lunes() -> BezierTriangles:
    """Return the unit sphere as four quadratic lunes from pole to pole: the fewest patches."""
    south, north = np.array([0.0, 0, -1]), np.array([0.0, 0, 1])
    # each arc is half of a great circle, named by a point on its other half
    around = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    return BezierTriangles(
        [sphere_lune(south, north, around[k], around[(k + 1) % 4]) for k in range(4)]
    )


def _unit_point(parameter: str, value: Any) -> np.ndarray:
    x = vector(parameter, value)
    if abs(np.linalg.norm(x) - 1) > ZERO:
        raise GeometryError.expected(
            parameter, "a point of the unit sphere", f"{x.tolist()}, of length {np.linalg.norm(x)}"
        )
    return x


def sphere_face(corners: Any, center: Any) -> np.ndarray:
    """Return the patch of three points of the unit sphere that is projected from a fourth.

    Parameters
    ----------
    corners : (3, 3) array_like
        Points of the unit sphere.
    center : (3,) array_like
        Centre of projection on the unit sphere, not in the plane of the corners. The edges
        are arcs of the circles through two corners and the centre, and avoid the centre.

    Returns
    -------
    (6, 4) array
        Net with corner weights 1, so that the edges have the standard parameters of arcs.

    Raises
    ------
    GeometryError
        If points are not on the sphere, or the four lie in a plane.
    """
    p = finite_array("corners", corners, (3, 3), GeometryError)
    p = np.array([_unit_point("corners", x) for x in p])
    s = _unit_point("center", center)
    if not (np.linalg.norm(p - s, axis=1) > ZERO).all():
        raise GeometryError.expected("center", "a point that is no corner", f"{s.tolist()}")
    net = project_faces(p, s)
    if not abs(np.linalg.det(p - s)) > ZERO * np.prod(np.linalg.norm(p - s, axis=1)):
        raise GeometryError.expected("center", "a point off the plane of the corners", s.tolist())
    return net


def project_faces(corners: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Return the nets of `sphere_face` for arrays ``(..., 3, 3)`` and ``(..., 3)``, unchecked."""
    # b_ii has the weight 2 (1 - S.P) = |S - P|^2 times the square of the factor of P
    factor = 1 / np.linalg.norm(corners - centers[..., None, :], axis=-1)
    return project_triangles(
        _UNIT_SPHERE, _with_weight(centers, 1), _with_weight(corners, 1) * factor[..., None]
    )


def _with_weight(points: np.ndarray, weight: float) -> np.ndarray:
    return np.concatenate([points, np.full((*points.shape[:-1], 1), weight)], axis=-1)


def _along(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return scalar products of vectors, keeping the axis."""
    return (a * b).sum(axis=-1, keepdims=True)


def arc_tangent(start: np.ndarray, end: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the unit tangent at `start` of the arc to `end` on the circle through `other`.

    All are points of the unit sphere, arrays ``(..., 3)``; the arc is the one that avoids
    `other`.
    """
    chord, aside = end - start, other - start
    tangent = np.cross(np.cross(chord, aside), start)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    # the arc lies on the side of the chord opposite to the third point
    across = aside - _along(aside, chord) / _along(chord, chord) * chord
    return np.where(_along(tangent, across) > 0, -tangent, tangent)


def lune_between(
    start: np.ndarray, end: np.ndarray, right: np.ndarray, left: np.ndarray
) -> np.ndarray:
    """Return the nets of lunes between two arcs given by their unit tangents at `start`.

    All are arrays ``(..., 3)``. A lune is oriented outwards if a turn by less than half a turn,
    counter-clockwise seen from outside, takes `right` to `left`.
    """
    # tangents as long as the chord give the corner weights 1
    length = np.linalg.norm(end - start, axis=-1)[..., None]
    points = np.stack(
        [_with_weight(end, 1), _with_weight(length * left, 0), _with_weight(length * right, 0)],
        axis=-2,
    )
    nets = project_triangles(_UNIT_SPHERE, _with_weight(start, 1), points)
    return nets / length[..., None] ** 2


def sphere_lune(start: Any, end: Any, first: Any, second: Any) -> np.ndarray:
    """Return the lune between two arcs of circles on the unit sphere.

    Both arcs lead from `start` to `end`, one in the plane through `first` and one in the
    plane through `second`, and avoid these points. Projected from `start`, the lune is the angle
    at `end` between two parallels to the tangents at `start`: a quadratic patch with two
    corners, and the edge between them, in `start`. It is the degenerate four-sided patch of the
    covers: its fourth edge is collapsed into `end`.

    Parameters
    ----------
    start, end, first, second : (3,) array_like
        Points of the unit sphere.

    Returns
    -------
    (6, 4) array
        Net with corner weights 1, oriented outwards whatever the order of the arcs; the angle
        of the lune is less than half a turn.

    Raises
    ------
    GeometryError
        If points are not on the sphere or coincide, or there is no angle between the arcs.
    """
    p, q, a, b = (
        _unit_point(name, x)
        for name, x in (("start", start), ("end", end), ("first", first), ("second", second))
    )
    for names, x, y in (
        ("start, end", p, q),
        ("start, first", p, a),
        ("end, first", q, a),
        ("start, second", p, b),
        ("end, second", q, b),
    ):
        if np.linalg.norm(x - y) <= ZERO:
            raise GeometryError.expected(names, "two different points", f"{x.tolist()} twice")
    right, left = arc_tangent(p, q, a), arc_tangent(p, q, b)
    turn = np.linalg.det([right, left, p])
    if abs(turn) <= ZERO:  # the sine of the angle
        raise GeometryError.expected(
            "first, second", "two arcs at an angle of less than half a turn", f"sine {turn:.3g}"
        )
    if turn < 0:
        right, left = left, right
    return lune_between(p, q, right, left)


_COVERS = {"octants": octants, "tetrahedral": tetrahedral, "lunes": lunes}


def _unit_cover(cover: Any) -> BezierTriangles:
    """Return the cover of the unit sphere that a user names or gives."""
    if isinstance(cover, BezierTriangles):
        return cover
    if not isinstance(cover, str) or cover not in _COVERS:
        raise GeometryError.expected(
            "cover", f"one of {', '.join(map(repr, _COVERS))}, or BezierTriangles", repr(cover)
        )
    return _COVERS[cover]()


def sphere(
    center: Any = (0, 0, 0), radius: float = 1, cover: str | BezierTriangles = "octants"
) -> BezierTriangles:
    """Return a sphere as an exact, closed cover, oriented outwards.

    Parameters
    ----------
    center : (3,) array_like
        Centre, in scene units.
    radius : float
        Radius, positive, in scene units.
    cover : {"octants", "tetrahedral", "lunes"} or BezierTriangles
        Eight quartic patches; four quadratic faces and six quadratic lunes; four quadratic
        lunes; or a cover of the unit sphere, as from `triangulations.triangulated`.

    Raises
    ------
    GeometryError
        If a parameter is not of this form.

    Examples
    --------
    >>> ball = mb.sphere(center=(0, 0, 1), radius=2)
    >>> len(ball), ball.degree
    (8, 4)
    >>> ball.bounds()[:, 1].max(axis=0).tolist()
    [2.0, 2.0, 3.0]
    >>> mb.sphere(cover="tetrahedral").degree
    2
    """
    c, r = vector("center", center), length("radius", radius)
    matrix = np.diag([r, r, r, 1.0])
    matrix[:3, 3] = c
    return _unit_cover(cover).transform(matrix)


# Rows: coordinates on the normal quadric from those on the unit sphere.
_FROM_SPHERE = {
    "ellipsoid": np.eye(4),
    # x^2 + y^2 = z w from x^2 + y^2 = (w + z)(w - z): the north pole becomes ideal
    "elliptic paraboloid": np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, -1, 1]]),
    # x^2 + y^2 - z^2 + w^2 = 0: the equator becomes ideal
    "hyperboloid of two sheets": np.array(
        [[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]]
    ),
}


def quadric_cover(A: Any, cover: str | BezierTriangles = "tetrahedral") -> BezierTriangles:
    """Return a closed cover of an oval quadric, the image of one of the sphere.

    Parameters
    ----------
    A : (4, 4) array_like
        Symmetric matrix of an ellipsoid, an elliptic paraboloid or a hyperboloid of two sheets.
    cover : {"octants", "tetrahedral", "lunes"} or BezierTriangles
        As for `sphere`.

    Returns
    -------
    BezierTriangles
        For an ellipsoid closed and oriented outwards. The other two are closed in projective
        space only: patches run through the ideal plane, where their weights change sign.

    Raises
    ------
    GeometryError
        If `A` is not such a quadric.

    Examples
    --------
    >>> len(mb.quadric_cover(np.diag([1.0, 4, 9, -1])))
    10
    """
    form = normal_form(A)
    if form.name not in _FROM_SPHERE:
        raise GeometryError.expected(
            "A", "an oval quadric (" + ", ".join(_FROM_SPHERE) + ")", form.name
        )
    return _unit_cover(cover).transform(form.matrix @ _FROM_SPHERE[form.name])


def ruled_cover(A: Any) -> BezierTriangles:
    """Return a closed cover of a ruled quadric: eight quadratic triangles.

    A ruled quadric is a torus in projective space, the product of its two families of
    lines; each family is covered by two segments, each product is a bilinear patch.

    Parameters
    ----------
    A : (4, 4) array_like
        Symmetric matrix of a hyperboloid of one sheet or a hyperbolic paraboloid.

    Returns
    -------
    BezierTriangles
        Closed in projective space; patches run through the ideal plane.

    Raises
    ------
    GeometryError
        If `A` is not such a quadric.

    Examples
    --------
    >>> len(mb.ruled_cover(np.diag([1.0, 1, -1, -1])))
    8
    """
    if projective_type(A) != "ruled":
        raise GeometryError.expected("A", "a ruled quadric", classify_quadric(A))
    segments = np.array([[[1.0, 0], [0, 1]], [[0, 1], [-1, 0]]])
    nets = []
    for first in segments:
        for second in segments:
            net = np.empty((2, 2, 4))
            for i, (a, b) in enumerate(first):
                for j, (c, d) in enumerate(second):
                    # (x - y)(x + y) = z w
                    net[i, j] = [(a * d + b * c) / 2, (b * c - a * d) / 2, a * c, b * d]
            nets.append(net)
    return tensor_to_triangles(nets).transform(collineation_to_paraboloid(A).inverse)
