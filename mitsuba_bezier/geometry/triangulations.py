"""Covers of the sphere after a triangulation of points on it, given by the user."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GeometryError
from .checks import finite_array
from .covers import arc_tangent, lune_between, project_faces
from .triangles import BezierTriangles

__all__ = ["triangulated"]


def _checked_triangulation(points: Any, faces: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors and faces of a closed triangulation that covers the sphere once."""
    p = finite_array("points", points, (None, 3), GeometryError)
    # 1e-6: points rounded to float32 pass, and are moved back onto the sphere
    radius = np.linalg.norm(p, axis=1)
    if not (np.abs(radius - 1) <= 1e-6).all():
        k = int(np.argmax(np.abs(radius - 1)))
        raise GeometryError.expected(
            "points", "points of the unit sphere", f"distance {radius[k]:.6g} of point {k}"
        )
    p = p / radius[:, None]
    f = np.asarray(faces)
    if f.ndim != 2 or f.shape[1] != 3 or not len(f) or not np.issubdtype(f.dtype, np.integer):
        raise GeometryError.expected(
            "faces", "integers (F, 3)", f"shape {f.shape}, dtype {f.dtype}"
        )
    if f.min() < 0 or f.max() >= len(p):
        raise GeometryError.expected(
            "faces", f"point numbers 0 .. {len(p) - 1}", f"{f.min()} .. {f.max()}"
        )
    f = f.astype(np.int64)
    directed = np.stack([f, np.roll(f, -1, axis=1)], axis=-1).reshape(-1, 2)
    loops = directed[:, 0] == directed[:, 1]
    if loops.any():
        k = int(np.argmax(loops)) // 3
        raise GeometryError.expected("faces", "three different points a face", f"{f[k].tolist()}")
    unique, count = np.unique(directed, axis=0, return_counts=True)
    if (count > 1).any():
        i, j = unique[np.argmax(count > 1)]
        raise GeometryError.expected(
            "faces",
            "each edge in two faces of the same orientation",
            f"edge {i}-{j} twice in this direction",
        )
    single = ~np.isin(unique @ [len(p), 1], unique[:, ::-1] @ [len(p), 1])
    if single.any():
        i, j = unique[np.argmax(single)]
        raise GeometryError.expected(
            "faces", "a closed triangulation", f"a gap: edge {i}-{j} has one face only"
        )
    # positive: counter-clockwise from outside, and less than a hemisphere
    turn = np.linalg.det(p[f])
    if (turn < 0).all():
        raise GeometryError.expected(
            "faces", "faces counter-clockwise seen from outside", "all of them clockwise"
        )
    # 1e-12: the three points and the centre of the sphere would be dependent to rounding
    if not (turn > 1e-12).all():
        k = int(np.argmin(turn))
        raise GeometryError.expected(
            "faces",
            "spherical triangles within a hemisphere, counter-clockwise from outside",
            f"face {k} with determinant {turn[k]:.3g}",
        )
    # Van Oosterom and Strackee (1983): tan of half the solid angle
    a, b, c = p[f[:, 0]], p[f[:, 1]], p[f[:, 2]]
    below = 1 + (a * b).sum(1) + (b * c).sum(1) + (c * a).sum(1)
    times = 2 * np.arctan2(turn, below).sum() / (4 * np.pi)
    if abs(times - 1) > 1e-6:  # it is an integer up to rounding
        raise GeometryError.expected(
            "faces", "a triangulation that covers the sphere once", f"{times:.3g} times"
        )
    return p, f


def triangulated(points: Any, faces: Any) -> BezierTriangles:
    """Return the unit sphere covered after any triangulation of points on it.

    Each face is projected from the antipode S of its centroid. Its edges are then arcs that
    bend into the spherical triangle (a great circle would be the edge if S were the antipode of
    a point on it), so between two neighbours there is a lune, never an overlap. Lunes of more
    than a right angle are cut in equal parts.

    Parameters
    ----------
    points : (N, 3) array_like
        Points of the unit sphere, within 1e-6.
    faces : (F, 3) array_like of int
        Spherical triangles, each within a hemisphere, counter-clockwise seen from outside,
        that cover the sphere once.

    Returns
    -------
    BezierTriangles
        Quadratic patches, oriented outwards: first the `F` faces in their order, then the
        lunes. Neighbours have equal parameters along their common edge.

    Raises
    ------
    GeometryError
        If points lie off the sphere, or faces overlap, leave a gap, are too large, or are
        turned inwards.

    Examples
    --------
    >>> octahedron = np.vstack([np.eye(3), -np.eye(3)])
    >>> upper = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2]]
    >>> faces = upper + [[b, a, 5] for a, b, _ in upper]
    >>> len(mb.triangulated(octahedron, faces))  # 8 faces, 12 lunes
    20
    """
    p, f = _checked_triangulation(points, faces)
    centers = -p[f].sum(axis=1)
    centers /= np.linalg.norm(centers, axis=1, keepdims=True)
    # the face on the other side of each directed edge
    edges = np.concatenate([f[:, [k, (k + 1) % 3]] for k in range(3)])
    owner = np.tile(np.arange(len(f)), 3)
    order, reverse = np.lexsort(edges.T), np.lexsort(edges[:, ::-1].T)
    across = np.empty(len(edges), dtype=int)
    across[order] = owner[reverse]
    once = edges[:, 0] < edges[:, 1]
    start, end = (p[edges[once, k]] for k in (0, 1))
    gaps = _lunes_between(start, end, centers[owner[once]], centers[across[once]])
    return BezierTriangles(np.concatenate([project_faces(p[f], centers), gaps]))


def _lunes_between(
    start: np.ndarray, end: np.ndarray, left: np.ndarray, right: np.ndarray
) -> np.ndarray:
    """Return the lunes between the arcs of two faces, in parts of at most a right angle."""
    # angles at `start`, from the great circle to the left
    along = end - (end * start).sum(axis=1, keepdims=True) * start
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    aside = np.cross(start, along)
    first, last = (
        np.arctan2((t * aside).sum(axis=1), (t * along).sum(axis=1))
        for t in (arc_tangent(start, end, right), arc_tangent(start, end, left))
    )
    # a right angle with rounding is not cut
    parts = np.ceil((last - first) / (np.pi / 2) - 1e-9).astype(int)
    which = np.repeat(np.arange(len(start)), parts)
    number = np.arange(len(which)) - np.repeat(np.cumsum(parts) - parts, parts)
    step = ((last - first) / parts)[which]

    def ray(angle: np.ndarray) -> np.ndarray:
        return np.cos(angle)[:, None] * along[which] + np.sin(angle)[:, None] * aside[which]

    angle = first[which] + number * step
    return lune_between(start[which], end[which], ray(angle), ray(angle + step))
