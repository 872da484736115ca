"""Find where visibility changes: contours from a point, open edges and creases, as segments."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np

from .proper_nets import spans_area
from .triangles import BezierTriangles

__all__ = ["POINTS", "Segments", "contour_segments", "edge_segments", "open_edges"]

#: Lattice points that all patches of a shape together are searched at, about.
POINTS = 40000
#: Edges of patches in parameters: from where to where.
_EDGES = np.array([[[1.0, 0], [0, 1]], [[0, 1], [0, 0]], [[0, 0], [1, 0]]])
#: Distance, relative to the extent of a shape, within which edges are one.
_TOGETHER = 1e-5
#: Angle in radians between the normals at a common edge from which it is a crease.
_CREASE = 1e-2


@dataclass
class Segments:
    """Pieces of curves in the parameters of patches.

    A piece of a contour is the graph of a function over its chord from `a` to `b`; a piece of
    an edge is the chord.
    """

    patch: np.ndarray  #: (N,) int
    a: np.ndarray  #: (N, 2), the ends
    b: np.ndarray
    is_edge: np.ndarray  #: (N,) bool

    def __len__(self) -> int:
        return len(self.patch)

    @staticmethod
    def join(parts: list[Segments]) -> Segments:
        """Return all segments of a list in one."""
        return Segments(
            *(
                np.concatenate([getattr(p, name) for p in parts])
                for name in ("patch", "a", "b", "is_edge")
            )
        )


def _facing(
    patches: BezierTriangles, patch: np.ndarray, uv: np.ndarray, eye: np.ndarray
) -> np.ndarray:
    """Return ``det(X, X_u, X_v, eye)``: 0 where the tangent plane contains the eye.

    It is a polynomial, so it is defined also where the patch runs through infinity.
    """
    x, xu, xv = (h[:, :3] - h[:, 3:] * eye for h in patches.partials(patch, uv, order=1))
    return np.einsum("ni,ni->n", x, np.cross(xu, xv))


def _lattice(r: int) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes ``(N, 2)`` and triangles ``(r^2, 3)`` of a lattice in the parameters."""
    number = {}
    nodes: list[tuple[float, float]] = []
    for i in range(r + 1):
        for j in range(r + 1 - i):
            number[i, j] = len(nodes)
            nodes.append((i / r, j / r))
    triangles = []
    for i in range(r):
        for j in range(r - i):
            triangles.append((number[i, j], number[i + 1, j], number[i, j + 1]))
            if i + j < r - 1:
                triangles.append((number[i + 1, j + 1], number[i, j + 1], number[i + 1, j]))
    return np.array(nodes), np.array(triangles)


def contour_segments(patches: BezierTriangles, eye: np.ndarray, points: float = POINTS) -> Segments:
    """Find the curves on which a surface is seen edge-on.

    The sign of the facing is taken on a lattice; a contour that lies between its points, a loop
    smaller than a cell, is not found. What is found, is exact: ends are roots on the edges of
    cells, to rounding.

    Parameters
    ----------
    patches : BezierTriangles
    eye : (3,) array
        The point of view.
    points : float
        At how many points of the lattice to look, about.

    Returns
    -------
    Segments
    """
    count = len(patches)
    r = int(np.clip(np.sqrt(2 * points / count), 4, 48))
    nodes, triangles = _lattice(r)
    index = np.repeat(np.arange(count), len(nodes))
    values = _facing(patches, index, np.tile(nodes, (count, 1)), eye).reshape(count, -1)
    positive = values > 0
    corner = positive[:, triangles]
    patch, cell = np.nonzero(corner.any(axis=2) & ~corner.all(axis=2))
    sign = corner[patch, cell]
    # the corner that differs from the other two
    lone = np.where(sign[:, 1] == sign[:, 2], 0, np.where(sign[:, 0] == sign[:, 2], 1, 2))
    node = triangles[cell]
    at = np.arange(len(cell))
    ends = []
    for other in (1, 2):
        pair = np.stack([node[at, lone], node[at, (lone + other) % 3]], axis=1)
        # ordered, so that neighbouring cells compute the same end
        pair.sort(axis=1)
        ends.append(_root(patches, patch, nodes[pair[:, 0]], nodes[pair[:, 1]], eye))
    a, b = ends
    # at collapsed edges the facing is 0, with the sign of a rounding; nothing is to be seen there
    start, end = patches.points(patch, a), patches.points(patch, b)
    length = np.linalg.norm(end - start, axis=1)
    finite = np.isfinite(length)
    extent = np.ptp(start[finite], axis=0).max() if finite.any() else 0.0
    good = finite & (length > 1e-7 * extent) & spans_area(patches.control_points)[patch]
    return Segments(patch[good], a[good], b[good], np.zeros(good.sum(), dtype=bool))


def _root(
    patches: BezierTriangles, patch: np.ndarray, a: np.ndarray, b: np.ndarray, eye: np.ndarray
) -> np.ndarray:
    """Return the roots of the facing between `a` and `b` by bisection."""
    low = _facing(patches, patch, a, eye) > 0
    lo, hi = np.zeros(len(a)), np.ones(len(a))
    for _ in range(30):
        middle = (lo + hi) / 2
        same = (_facing(patches, patch, a + middle[:, None] * (b - a), eye) > 0) == low
        lo, hi = np.where(same, middle, lo), np.where(same, hi, middle)
    return a + ((lo + hi) / 2)[:, None] * (b - a)


def edge_segments(patches: BezierTriangles, parts: int = 16) -> Segments:
    """Return the open edges and the creases of a surface, each crease once.

    Edges of two patches that are the same curve are joined, whatever their parameters; where the
    surface has one normal there, nothing changes across them and they are left out.

    Parameters
    ----------
    patches : BezierTriangles
    parts : int
        Into how many segments an edge is cut.
    """
    chosen = open_edges(patches)
    steps = np.linspace(0, 1, parts + 1)
    patch = np.repeat(chosen // 3, parts)
    start, end = _EDGES[chosen % 3, 0], _EDGES[chosen % 3, 1]
    points = start[:, None] + steps[None, :, None] * (end - start)[:, None]
    a, b = points[:, :-1].reshape(-1, 2), points[:, 1:].reshape(-1, 2)
    ends = [patches.points(patch, x) for x in (a, b)]
    finite = np.isfinite(ends[0]).all(axis=1) & np.isfinite(ends[1]).all(axis=1)
    good = np.repeat(finite.reshape(-1, parts).all(axis=1), parts)  # edges as a whole
    return Segments(patch[good], a[good], b[good], np.ones(good.sum(), dtype=bool))


def open_edges(patches: BezierTriangles, creases: bool = True) -> np.ndarray:
    """Return numbers ``3 * patch + edge`` of the edges without a neighbour, and of creases.

    The edges of a patch are AB, BC, CA.
    """
    count = len(patches)
    t = np.linspace(0, 1, 65)
    lines = _EDGES[:, None, 0] + t[None, :, None] * (_EDGES[:, None, 1] - _EDGES[:, None, 0])
    points = patches.points(
        np.repeat(np.arange(count), 3 * len(t)), np.tile(lines.reshape(-1, 2), (count, 1))
    ).reshape(3 * count, len(t), 3)
    finite = np.isfinite(points).all(axis=(1, 2))
    box = points[finite].reshape(-1, 3)
    extent = (float(np.ptp(box, axis=0).max()) if len(box) else 0.0) or 1.0
    length = np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1)
    usable = finite & (length > 1e-6 * extent)

    ends = np.rint(points[:, [0, -1]] / (4 * _TOGETHER * extent))
    bucket: dict[tuple[Any, ...], list[int]] = defaultdict(list[Any])
    for number in np.flatnonzero(usable):
        first, last = (tuple(x) for x in ends[number])
        bucket[min(first, last), max(first, last)].append(int(number))
    out = [int(e) for e in np.flatnonzero(~finite)]
    for edges in bucket.values():
        alone = set(edges)
        for i, e in enumerate(edges):
            for f in edges[i + 1 :]:
                if e in alone and f in alone and _same_curve(points[e], points[f], extent):
                    alone -= {e, f}
                    if creases and _is_crease(patches, e, f, points):
                        out.append(e)
        out.extend(alone)
    return np.array(sorted(out), dtype=int)


def _distance(p: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances of points ``(N, 3)`` from a polyline, and the nearest nodes."""
    a, d = line[:-1], np.diff(line, axis=0)
    rel = p[:, None] - a[None]
    s = np.einsum("nkc,kc->nk", rel, d) / np.maximum(np.einsum("kc,kc->k", d, d), 1e-300)
    off = np.linalg.norm(rel - np.clip(s, 0, 1)[..., None] * d, axis=2)
    return off.min(axis=1), off.argmin(axis=1)


def _same_curve(p: np.ndarray, q: np.ndarray, extent: float) -> bool:
    # a polyline of 64 chords leaves its curve by up to a chord's sagitta, some 3e-5
    sagitta = np.linalg.norm(q[:-2] - 2 * q[1:-1] + q[2:], axis=1).max() / 4
    off, _ = _distance(p[[16, 32, 48]], q)
    return bool((off < _TOGETHER * extent + sagitta).all())


def _is_crease(patches: BezierTriangles, e: int, f: int, points: np.ndarray) -> bool:
    at = np.array([16, 32, 48])
    _off, near = _distance(points[e][at], points[f])
    normals = []
    for edge, steps in ((e, at), (f, near)):
        start, end = _EDGES[edge % 3]
        uv = start + (steps / 64)[:, None] * (end - start)
        normals.append(patches.normals(np.full(3, edge // 3), uv))
    sine = np.linalg.norm(np.cross(normals[0], normals[1]), axis=1)
    facing = np.einsum("ni,ni->n", normals[0], normals[1])
    # the nearest node of the other polyline may be 1/64 of the edge away
    return bool(((sine > _CREASE + 0.05) | (facing < 0)).any())
