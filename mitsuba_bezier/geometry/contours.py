"""Find where visibility changes: contours from a point, open edges and creases, as segments."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from . import bernstein
from .proper_nets import free_of_factor, spans_area
from .triangles import BezierTriangles

__all__ = ["POINTS", "Segments", "contour_segments", "edge_segments", "open_edges"]

#: Lattice points that all patches of a shape together are searched at, about.
POINTS = 40000
#: Roots are known to this part of an edge of the lattice; after so many cuts to 2^-7 at worst.
_ROOT, _CUTS = 1e-10, 30
#: Edges of patches in parameters: from where to where.
_EDGES = np.array([[[1.0, 0], [0, 1]], [[0, 1], [0, 0]], [[0, 0], [1, 0]]])
#: Distance, relative to the extent of a shape, within which edges are one.
_TOGETHER = 1e-5
#: Angle in radians between the normals at a common edge from which it is a crease.
_CREASE = 1e-2
#: Nodes of an edge's polyline of 64 chords at which edges are compared.
_AT = np.array([16, 32, 48])
#: Pairs of edges looked at together: bounds the memory.
_CHUNK = 4096


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


class _Facing:
    """``det(X, X_u, X_v, eye)`` of patches: 0 where the tangent plane contains the eye.

    It is a polynomial, so it is defined also where the patch runs through infinity.
    """

    def __init__(self, patches: BezierTriangles, eye: np.ndarray) -> None:
        net = free_of_factor(patches.control_points)
        self.degree = patches.degree
        #: seen from the eye: the homogeneous determinant is that of three vectors of these
        self.nets = net[..., :3] - net[..., 3:] * eye

    def _bases(self, uv: np.ndarray) -> list[np.ndarray]:
        """Return the rows that make value and partials of a net."""
        lower = bernstein.basis(self.degree - 1, uv)
        partials = (lower @ d for d in bernstein.partials_matrices(self.degree))
        return [bernstein.basis(self.degree, uv), *partials]

    def everywhere(self, uv: np.ndarray) -> np.ndarray:
        """Return values ``(P, N)`` of all patches at the same parameters."""
        x, xu, xv = (b @ self.nets for b in self._bases(uv))
        return np.asarray(_determinant(x, xu, xv))

    def at(self, nets: np.ndarray, uv: np.ndarray) -> np.ndarray:
        """Return values ``(N,)`` of `nets`, rows of those of the patches, each where it says."""
        x, xu, xv = (np.einsum("nk,nkc->nc", b, nets) for b in self._bases(uv))
        return np.asarray(_determinant(x, xu, xv))


def _determinant(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    out: np.ndarray = (
        x[..., 0] * (y[..., 1] * z[..., 2] - y[..., 2] * z[..., 1])
        + x[..., 1] * (y[..., 2] * z[..., 0] - y[..., 0] * z[..., 2])
        + x[..., 2] * (y[..., 0] * z[..., 1] - y[..., 1] * z[..., 0])
    )
    return out


@cache
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
    facing = _Facing(patches, eye)
    values = facing.everywhere(nodes)
    positive = values > 0
    corner = positive[:, triangles]
    patch, cell = np.nonzero(corner.any(axis=2) & ~corner.all(axis=2))
    sign = corner[patch, cell]
    # the corner that differs from the other two
    lone = np.where(sign[:, 1] == sign[:, 2], 0, np.where(sign[:, 0] == sign[:, 2], 1, 2))
    node = triangles[cell]
    at = np.arange(len(cell))
    pair = np.stack([node[at, lone]] * 2 + [node[at, (lone + k) % 3] for k in (1, 2)])
    pair = pair.reshape(2, -1)
    pair.sort(axis=0)  # so that neighbouring cells compute the same end
    twice = np.tile(patch, 2)
    known = values[twice, pair]
    a, b = _root(facing, twice, *nodes[pair], *known).reshape(2, -1, 2)
    # at collapsed edges the facing is 0, with the sign of a rounding; nothing is to be seen there
    start, end = patches.points(patch, a), patches.points(patch, b)
    length = np.linalg.norm(end - start, axis=1)
    finite = np.isfinite(length)
    extent = np.ptp(start[finite], axis=0).max() if finite.any() else 0.0
    good = finite & (length > 1e-7 * extent) & spans_area(patches.control_points)[patch]
    return Segments(patch[good], a[good], b[good], np.zeros(good.sum(), dtype=bool))


def _root(
    facing: _Facing,
    patch: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
    at_a: np.ndarray,
    at_b: np.ndarray,
) -> np.ndarray:
    """Return the roots of the facing between `a` and `b`, where it has two signs.

    Illinois' rule: the bracket is cut by its chord, and the value at an end that stays twice counts
    half. Every fourth cut is in the middle.
    """
    nets, chord = facing.nets[patch], b - a
    lo, hi, f_lo, f_hi = np.zeros(len(a)), np.ones(len(a)), at_a, at_b
    root, moved, out = np.full(len(a), np.nan), np.zeros(len(a)), np.zeros(len(a))
    left = np.arange(len(a))
    for step in range(_CUTS):
        with np.errstate(divide="ignore", invalid="ignore"):
            guess = lo - f_lo * (hi - lo) / (f_hi - f_lo)
        inside = (guess > lo) & (guess < hi) & (step % 4 < 3)
        before, root = root, np.where(inside, guess, (lo + hi) / 2)
        f = facing.at(nets[left], a[left] + root[:, None] * chord[left])
        same = (f > 0) == (f_lo > 0)
        f_lo, f_hi = (
            np.where(same, f, np.where(moved < 0, f_lo / 2, f_lo)),
            np.where(same, np.where(moved > 0, f_hi / 2, f_hi), f),
        )
        lo, hi = np.where(same, root, lo), np.where(same, hi, root)
        moved = np.where(same, 1, -1)
        out[left] = root
        go_on = np.fmin(np.abs(root - before), hi - lo) > _ROOT
        if not go_on.any():
            break
        left = left[go_on]
        lo, hi, f_lo, f_hi, root, moved = (x[go_on] for x in (lo, hi, f_lo, f_hi, root, moved))
    return a + out[:, None] * chord


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
    pairs = []
    for edges in bucket.values():
        alone = set(edges)
        for i, e in enumerate(edges):
            for f in edges[i + 1 :]:
                if e in alone and f in alone and _same_curve(points[e], points[f], extent):
                    alone -= {e, f}
                    pairs.append((e, f))
        out.extend(alone)
    if creases and pairs:
        first, second = np.array(pairs).T
        out.extend(first[_are_creases(patches, first, second, points)].tolist())
    return np.array(sorted(out), dtype=int)


def _nearest(p: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances of points ``(..., N, 3)`` from polylines ``(..., K, 3)``, and nodes."""
    a, d = line[..., :-1, :], np.diff(line, axis=-2)
    rel = p[..., :, None, :] - a[..., None, :, :]
    square = np.maximum(np.einsum("...kc,...kc->...k", d, d), 1e-300)
    s = np.einsum("...nkc,...kc->...nk", rel, d) / square[..., None, :]
    off = np.linalg.norm(rel - np.clip(s, 0, 1)[..., None] * d[..., None, :, :], axis=-1)
    return off.min(axis=-1), off.argmin(axis=-1)


def _same_curve(p: np.ndarray, q: np.ndarray, extent: float) -> bool:
    # a polyline of 64 chords leaves its curve by up to a chord's sagitta, some 3e-5
    sagitta = np.linalg.norm(q[:-2] - 2 * q[1:-1] + q[2:], axis=1).max() / 4
    off, _ = _nearest(p[_AT], q)
    return bool((off < _TOGETHER * extent + sagitta).all())


def _are_creases(
    patches: BezierTriangles, first: np.ndarray, second: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Return which pairs of edges ``(N,)``, that are one curve each, are creases."""
    crease = np.zeros(len(first), dtype=bool)
    for begin in range(0, len(first), _CHUNK):
        e, f = first[begin : begin + _CHUNK], second[begin : begin + _CHUNK]
        _off, near = _nearest(points[e][:, _AT], points[f])
        normals = []
        for edge, steps in ((e, np.broadcast_to(_AT, near.shape)), (f, near)):
            start, end = _EDGES[edge % 3].transpose(1, 0, 2)[:, :, None]
            uv = start + (steps / 64)[..., None] * (end - start)
            patch = np.repeat(edge // 3, len(_AT))
            normals.append(patches.normals(patch, uv.reshape(-1, 2)).reshape(uv.shape[0], -1, 3))
        sine = np.linalg.norm(np.cross(normals[0], normals[1]), axis=-1)
        cosine = np.einsum("nki,nki->nk", *normals)
        # the nearest node of the other polyline may be 1/64 of the edge away
        crease[begin : begin + _CHUNK] = ((sine > _CREASE + 0.05) | (cosine < 0)).any(axis=1)
    return crease
