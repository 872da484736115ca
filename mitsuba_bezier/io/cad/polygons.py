"""Plane polygons with holes: area, edges that cross, and their triangulation by shapely."""

from __future__ import annotations

import numpy as np

__all__ = ["crossing", "triangulate"]


def _cross(o: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return twice the signed area of the triangles (o, a, b)."""
    return (a[..., 0] - o[..., 0]) * (b[..., 1] - o[..., 1]) - (a[..., 1] - o[..., 1]) * (
        b[..., 0] - o[..., 0]
    )


def signed_area(points: np.ndarray) -> float:
    """Return the signed area of a polygon ``(m, 2)``."""
    x, y = points.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def crossing(points: np.ndarray, edges: np.ndarray) -> set[int]:
    """Return the edges of a set that cross or touch others without a common end.

    Parameters
    ----------
    points : (N, 2) array
        The vertices.
    edges : (E, 2) int array
        Pairs of vertices.
    """
    a, b = points[edges[:, 0]], points[edges[:, 1]]
    low, high = np.minimum(a, b), np.maximum(a, b)
    out: set[int] = set()
    for e in range(len(edges) - 1):
        rest = slice(e + 1, None)
        near = ((low[rest] <= high[e]) & (high[rest] >= low[e])).all(axis=1)
        near &= ~np.isin(edges[rest], edges[e]).any(axis=1)
        others = e + 1 + np.flatnonzero(near)
        if len(others):
            d1 = _cross(a[e], b[e], a[others]) * _cross(a[e], b[e], b[others])
            d2 = _cross(a[others], b[others], a[e]) * _cross(a[others], b[others], b[e])
            hit = others[(d1 <= 0) & (d2 <= 0)]
            if len(hit):
                out |= {e, *hit.tolist()}
    return out


def triangulate(points: np.ndarray, loops: list[list[int]]) -> np.ndarray | None:
    """Return the constrained Delaunay triangulation of a polygon with holes, by GEOS.

    Parameters
    ----------
    points : (N, 2) array
        The vertices; no two of those used are equal.
    loops : list of list of int
        The outer loop, then the holes.

    Returns
    -------
    (T, 3) int array or None
        Counterclockwise triangles without new vertices; None if the polygon is not simple.
    """
    import shapely

    outer, *holes = (points[loop] for loop in loops)
    polygon = shapely.Polygon(outer, holes)
    if not polygon.is_valid:
        return None
    rings = shapely.get_exterior_ring(
        shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    )
    corners = shapely.get_coordinates(rings).reshape(-1, 4, 2)[:, :3]
    used = {tuple(points[i].tolist()): i for loop in loops for i in loop}
    faces = np.array([[used[tuple(corner)] for corner in face] for face in corners.tolist()])
    clockwise = _cross(*points[faces].swapaxes(0, 1)) < 0
    faces[clockwise] = faces[clockwise, ::-1]
    return faces
