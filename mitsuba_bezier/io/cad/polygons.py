"""Triangulation of plane polygons with holes: ears, bridges to holes, and flips for good angles."""

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


def _bridge(
    outer: list[int], hole: list[int], others: list[list[int]], points: np.ndarray
) -> list[int] | None:
    """Return the outer polygon joined with a hole by the shortest bridge that crosses no edge."""
    o, h = np.array(outer), np.array(hole)
    loops = [o, h, *map(np.array, others)]
    ends = np.concatenate([np.stack([loop, np.roll(loop, -1)], axis=1) for loop in loops])
    a, b = points[ends[:, 0]], points[ends[:, 1]]
    distance = np.linalg.norm(points[o][:, None] - points[h][None], axis=2)
    for at in np.argsort(distance, axis=None)[:2000]:
        i, j = divmod(int(at), len(h))
        p, q = points[o[i]], points[h[j]]
        free = ~np.isin(ends, [o[i], h[j]]).any(axis=1)
        d1 = _cross(p, q, a[free]) * _cross(p, q, b[free])
        d2 = _cross(a[free], b[free], p) * _cross(a[free], b[free], q)
        if ((d1 <= 0) & (d2 <= 0)).any() or not _leaves_inside(outer, i, q, points):
            continue
        return outer[: i + 1] + hole[j:] + hole[: j + 1] + outer[i:]
    return None


def _leaves_inside(polygon: list[int], i: int, q: np.ndarray, points: np.ndarray) -> bool:
    """Tell whether the segment from corner `i` to `q` starts inside of the polygon."""
    p = points[polygon[i]]
    before, after = points[polygon[i - 1]], points[polygon[(i + 1) % len(polygon)]]
    left_after = _cross(p, after, q) >= 0
    left_before = _cross(before, p, q) >= 0
    if _cross(before, p, after) >= 0:
        return bool(left_after and left_before)
    return bool(left_after or left_before)


def triangulate(points: np.ndarray, loops: list[list[int]]) -> np.ndarray | None:
    """Triangulate a polygon with holes.

    Parameters
    ----------
    points : (N, 2) array
        The vertices.
    loops : list of list of int
        The outer loop, counterclockwise, then the holes, clockwise.

    Returns
    -------
    (T, 3) int array or None
        Counterclockwise triangles without new vertices; None if the polygon is not simple.
    """
    polygon = list(loops[0])
    # holes from the right: each is joined to what is already connected
    holes = sorted(loops[1:], key=lambda h: -points[h, 0].max())
    while holes:
        for k, hole in enumerate(holes):
            rest = [list(other) for other in holes if other is not hole]
            joined = _bridge(polygon, list(hole), rest, points)
            if joined is not None:
                polygon = joined
                del holes[k]
                break
        else:
            return None
    triangles = _ears(points, polygon)
    if triangles is None:
        return None
    fixed = {frozenset((a, b)) for loop in loops for a, b in zip(loop, [*loop[1:], loop[0]])}
    return _flip(points, triangles, fixed)


def _ears(points: np.ndarray, polygon: list[int]) -> list[tuple[int, int, int]] | None:
    """Cut ears, the best shaped one first."""
    rest = list(polygon)
    out: list[tuple[int, int, int]] = []
    # shape of each ear from 0 to 1, or -1; then the vertex in its way, or -1
    known: dict[tuple[int, int, int], tuple[float, int]] = {}

    def value(key: tuple[int, int, int]) -> tuple[float, int]:
        a, b, c = points[list(key)]
        area = _cross(a, b, c)
        if area <= 0:
            return -1.0, -1
        others = np.array(rest)
        x = points[others]
        inside = (_cross(a, b, x) >= 0) & (_cross(b, c, x) >= 0) & (_cross(c, a, x) >= 0)
        inside &= (others != key[0]) & (others != key[1]) & (others != key[2])
        if inside.any():
            return -1.0, int(others[np.argmax(inside)])
        sides = ((b - a) @ (b - a)) + ((c - b) @ (c - b)) + ((a - c) @ (a - c))
        return float(2 * np.sqrt(3) * area / sides), -1

    while len(rest) > 3:
        best, where = -1.0, -1
        for k in range(len(rest)):
            key = (rest[k - 1], rest[k], rest[(k + 1) % len(rest)])
            if key not in known:
                known[key] = value(key)
            if known[key][0] > best:
                best, where = known[key][0], k
        if where < 0:
            return None
        out.append((rest[where - 1], rest[where], rest[(where + 1) % len(rest)]))
        gone = rest.pop(where)
        if gone not in rest:  # what it was in the way of may have become an ear
            known = {key: v for key, v in known.items() if v[1] != gone}
    if _cross(*points[rest]) <= 0:
        return None
    out.append((rest[0], rest[1], rest[2]))
    return out


def _flip(
    points: np.ndarray, triangles: list[tuple[int, int, int]], fixed: set[frozenset[int]]
) -> np.ndarray:
    """Flip inner edges until every one is locally Delaunay (Lawson)."""
    faces = [list(t) for t in triangles]
    owners: dict[frozenset[int], list[int]] = {}
    for t, face in enumerate(faces):
        for k in range(3):
            owners.setdefault(frozenset((face[k], face[(k + 1) % 3])), []).append(t)
    todo = [e for e, own in owners.items() if len(own) == 2 and e not in fixed]
    for _ in range(50 * len(faces) + 50):  # Lawson's algorithm ends; rounding might not let it
        if not todo:
            break
        edge = todo.pop()
        own = owners.get(edge, [])
        if len(own) != 2:
            continue
        s, t = own
        a, b = edge
        c = next(v for v in faces[s] if v not in edge)
        d = next(v for v in faces[t] if v not in edge)
        if (faces[s].index(b) - faces[s].index(a)) % 3 != 1:
            a, b = b, a  # now (a, b, c) and (b, a, d) are counterclockwise
        pa, pb, pc, pd = points[[a, b, c, d]]
        if _cross(pa, pd, pc) <= 0 or _cross(pd, pb, pc) <= 0:  # not a convex quadrilateral
            continue
        m = np.array([pa - pd, pb - pd, pc - pd])
        in_circle = np.linalg.det(np.column_stack([m, (m**2).sum(axis=1)]))
        if in_circle <= 1e-12 * np.abs(m).max() ** 4:
            continue
        faces[s], faces[t] = [a, d, c], [d, b, c]
        del owners[edge]
        owners[frozenset((c, d))] = [s, t]
        for e, old, new in ((frozenset((a, d)), t, s), (frozenset((b, c)), s, t)):
            owners[e] = [new if x == old else x for x in owners[e]]
        for e in (frozenset(p) for p in ((a, d), (d, b), (b, c), (c, a))):
            if len(owners[e]) == 2 and e not in fixed:
                todo.append(e)
    return np.array(faces)
